"""``make soak``: polish parts through the queue of simulated cells and add them to those of earlier sessions."""

from __future__ import annotations

import argparse
import json
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

from polishd.model.errors import PolishdError
from tests.campaigns.soak.cell import SoakCell
from tests.campaigns.soak.figures import Figures, life_table, table, write_page
from tests.campaigns.soak.parts import Part, drawn
from tests.campaigns.soak.records import Record
from tests.campaigns.soak.scripts import LIVED, SCRIPTS, Script
from tests.campaigns.soak.session import work
from tests.system.sim_rig import ROOT

FOLDER = ROOT / "build" / "soak"
PARTS, SESSION = 931, 40
SPEED = 20.0
"""Highest speed: above it a force sample (each 50 ms of wall time) covers too much of a pass."""
NAMED = {script.name: script for script in SCRIPTS}
EVIDENCE = 40
"""Number of failures of which the evidence is kept."""


class Soak:
    """Parallel sessions with their results."""

    def __init__(self, figures: Figures, folder: Path, until_s: float, only: Sequence[Script] = ()) -> None:
        self._figures, self._folder, self._until_s, self._only = figures, folder, until_s, only
        self._turn = threading.Lock()
        self.wrong: list[str] = []
        """Failures of sessions that concern no part."""

    def run(self, parts: int, cells: int, session: int = SESSION) -> None:
        """Polish those of the first ``parts`` that are not done."""
        done = self._figures.done
        blocks = [[n for n in range(first, min(first + session, parts)) if n not in done]
                  for first in range(0, parts, session)]  # fmt: skip
        with ThreadPoolExecutor(cells) as pool:
            for wrong in pool.map(self._run_session, filter(None, blocks)):
                self.wrong += wrong

    def leave(self, *_: object) -> None:
        """Complete the parts under way and begin no others."""
        self._until_s = 0.0

    def _run_session(self, numbers: list[int]) -> list[str]:
        if time.monotonic() > self._until_s:
            return []
        figures = self._figures
        parts: list[Part] = [drawn(figures.seed, number, self._only) for number in numbers]
        name = f"{numbers[0]:04d}-{datetime.now(UTC):%Y%m%dT%H%M%S}"
        folder = self._folder / "cells" / name
        try:
            wrong = work(folder, name, figures.seed, figures.speed, parts, lambda: self._until_s, self._keep)
        except PolishdError as error:
            wrong = [f"it did not begin, its parts are still to be done: {error}"]
        for said in wrong:
            say(f"soak: {name}: {said}")
        if not wrong:
            shutil.rmtree(folder)
        return wrong

    def _keep(self, record: Record, cell: SoakCell) -> None:
        with self._turn:
            self._figures.add(record)
            said = "; ".join(record.wrong) or "as it should be"
            cpu_s = sum(record.cpu_s.values())
            say(f"soak: {record.part} {record.script}: {record.verdict}, {record.wall_s:.1f} s, "
                f"{cpu_s:.1f} CPU s: {said}")  # fmt: skip
            if record.wrong:
                self._keep_evidence(record, cell)

    def _keep_evidence(self, record: Record, cell: SoakCell) -> None:
        """Keep the files that are needed to find the cause of a failure."""
        folder = self._folder / "evidence" / f"{record.part}-{record.session}"
        if folder.parent.exists() and len(list(folder.parent.iterdir())) >= EVIDENCE:
            return
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "record.json").write_text(json.dumps(self._figures.records[-1], indent=1))
        row = cell.row(record.part)
        if row is not None and row.run_dir:
            shutil.copytree(row.run_dir, folder / "run", dirs_exist_ok=True)
        files = cell.files
        for path in evidence_of(files.state_dir, files.sim_dir, files.out):
            shutil.copy(path, folder)


def evidence_of(state: Path, sim: Path, out: Path) -> Iterator[Path]:
    """Yield the files of cell and simulator that are kept as evidence and exist."""
    wanted = [*state.glob("*.log*"), *state.glob("journal.sqlite*"), *out.glob("*.log"), *out.glob("*.toml"),
              sim / "sim.log", sim / "dwell_account.json", sim / "truth.npz", out / "sim.stderr"]  # fmt: skip
    yield from (path for path in wanted if path.is_file())


def say(*words: object) -> None:
    """Print progress."""
    print(*words, file=sys.stderr, flush=True)


def main() -> int:
    """Run the campaign and return the exit code: 1 where anything was wrong."""
    parse = argparse.ArgumentParser(prog="make soak", description=__doc__)
    parse.add_argument("--parts", type=int, default=PARTS, help="in all")
    parse.add_argument("--life", type=int, default=0, help="instead: so many through one life of a daemon; what grows")
    parse.add_argument("--seed", type=int, default=1, help="another one draws other parts, and begins anew")
    parse.add_argument("--minutes", type=float, default=1e9, help="of this session; what was begun is ended")
    parse.add_argument("--cells", type=int, default=1, help="side by side")
    parse.add_argument("--speed", type=float, default=SPEED, help="of the simulated clock; another one begins anew")
    parse.add_argument("--only", nargs="+", default=[], choices=list(NAMED), help="faults of the parts, in this order")
    parse.add_argument("--folder", type=Path, default=FOLDER, help="where figures are kept between sessions")
    parse.add_argument("--json", action="store_true", help="nothing but the last line, which is JSON in any case")
    options = parse.parse_args()
    folder = options.folder.resolve()
    if options.only and folder == FOLDER:
        parse.error("--only needs a separate --folder: figures depend on the scripts")
    life = options.life > 0
    figures = Figures(folder, options.seed, options.speed, life=life)
    only = [NAMED[name] for name in options.only] or (LIVED if life else ())
    soak = Soak(figures, folder, time.monotonic() + 60 * options.minutes, only)
    signal.signal(signal.SIGTERM, soak.leave)
    if life:
        soak.run(options.life, 1, options.life)
    else:
        soak.run(options.parts, options.cells)
    sums = figures.sums()
    text = (life_table if life else table)(sums, figures.conditions())
    if folder == FOLDER and sums.all:
        write_page(text, life=life)
    if not options.json:
        print(text)
    found = {**sums.summary(), "sessions_wrong": soak.wrong, "seed": figures.seed, "of": figures.of}
    print(json.dumps(found))
    return int(bool(found["wrong"] or soak.wrong))


if __name__ == "__main__":
    sys.exit(main())
