"""``make shop-campaign``: polish parts with three daemons and a shop that are killed at random, in sessions."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from collections import Counter
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from polishd.model.errors import PolishdError
from tests.campaigns import result_files
from tests.campaigns.shop.session import CELLS, Session
from tests.system.sim_rig import ROOT

FOLDER = ROOT / "build" / "shop"
PAGE = ROOT / "docs" / "reference" / "results.md"
BEGIN, END = "<!-- written by make shop-campaign -->\n", "<!-- end of it -->\n"
PARTS, SESSION, SPEED = 300, 30, 40.0
OF = ("polishd/shop", "polishd/daemon", "polishd/web/http")
"""Sources on which the results depend."""


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table of the page: the sums of all sessions."""
    sums = {key: sum(row[key] for row in rows) for key in ("parts", "passes", "torn", "events", "releases", "resumed")}
    kills, verdicts = Counter[str](), Counter[str]()
    for row in rows:
        kills += Counter(row["kills"])
        verdicts += Counter(row["verdicts"])
    wrong = [said for row in rows for said in row["wrong"]]
    hours = sum(row["seconds"] for row in rows) / 3600
    back = sum(row["given_back"] for row in rows)
    lines = [
        ("parts through the shop", f"{sums['parts']}: {', '.join(f'{n} {how}' for how, n in verdicts.most_common())}"),
        ("cells, sessions, hours", f"{len(CELLS)}, {len(rows)}, {hours:.2f}"),
        ("kill -9", ", ".join(f"{n} of a {who}" for who, n in kills.most_common())),
        ("passes, of them interrupted", f"{sums['passes']}, {sums['torn']}"),
        ("events of the journals at the shop", f"{sums['events']}"),
        ("parts wanted back while a cell had them, given back", f"{sums['releases']}, {back}"),
        ("times that a person had to resume a cell", f"{sums['resumed']}"),
        ("polished in two cells, passes lost or twice, events lost or twice, parts lost", f"{len(wrong)}"),
        ("last session", f"{rows[-1]['date']}, sources {rows[-1]['of']}"),
    ]
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in lines), ""])


def main() -> int:
    """Run the campaign and return the exit code: 1 where anything was wrong."""
    parse = argparse.ArgumentParser(prog="make shop-campaign", description=__doc__)
    parse.add_argument("--parts", type=int, default=PARTS, help="in all")
    parse.add_argument("--session", type=int, default=SESSION, help="parts of one session")
    parse.add_argument("--minutes", type=float, default=1e9, help="after which what was begun is ended")
    parse.add_argument("--seed", type=int, default=1, help="another one needs another --folder")
    parse.add_argument("--speed", type=float, default=SPEED, help="of the simulated clock")
    parse.add_argument("--folder", type=Path, default=FOLDER, help="where all is kept between sessions")
    options = parse.parse_args()
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    kept, until_s = folder / "sessions.jsonl", time.monotonic() + 60 * options.minutes
    rows = result_files.read(kept)
    stopping: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: stopping.append(number))
    while (done := sum(row["parts"] for row in rows)) < options.parts and time.monotonic() < until_s and not stopping:
        count = min(options.session, options.parts - done)
        try:
            session = Session(folder, options.seed, len(rows), options.speed)
            came = session.run(count, lambda: bool(stopping) or time.monotonic() > until_s, say)
        except PolishdError as error:  # before any part was added: the machine is too busy for a simulator to come up
            say(f"the session did not begin: {error}")
            continue
        rows.append(
            {**asdict(came), "date": result_files.today(), "of": result_files.sources(OF), "seed": options.seed}
        )
        result_files.keep(kept, rows)
        say(json.dumps(rows[-1]))
        if came.wrong:
            break  # the folder stays as it is for the analysis
    if folder == FOLDER and rows:
        result_files.write(PAGE, BEGIN, END, table(rows))
    print(table(rows) if rows else "nothing was done")
    return int(any(row["wrong"] for row in rows))


def say(words: str) -> None:
    """Print progress."""
    print(f"{datetime.now(UTC):%H:%M:%S} shop: {words}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
