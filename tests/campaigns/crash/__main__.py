"""``make crash``: crash states and kills, added to those of earlier sessions until there are as many as asked for."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import sys
import tempfile
import time
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path

from polishd.model.errors import PolishdError
from tests.campaigns.crash import attacks, kills, model
from tests.campaigns.crash.figures import SAID, Figures, table, write_page
from tests.campaigns.crash.recording import ROOT
from tests.campaigns.crash.states import rounds

FOLDER = ROOT / "build" / "crash"
STATES, KILLS, FAULTS = 100_000, 2_000, 3
BEGINNINGS = 10
"""So many cells may be starved before they begin, in one session."""


def say(*words: object) -> None:
    """Print the progress."""
    print(*words, file=sys.stderr, flush=True)


def run_states(figures: Figures, wanted: int, until_s: float) -> None:
    """Rounds until there are as many different states as wanted; each is kept when it is done."""
    if figures.states >= wanted:
        return
    say("crash: recording two jobs of the daemon, or taking those of an earlier session")
    recording = figures.recording()
    for variants, tried in rounds(recording, figures.variants, int(figures.all["seed"]), figures.keys):
        figures.add_states(variants, tried)
        say(f"crash: {figures.states} of {wanted} states, wrong: {figures.all['states']['bad'] or 'none'}")
        if figures.states >= wanted or time.monotonic() > until_s:
            return


def run_kills(figures: Figures, wanted: int, until_s: float) -> None:
    """Cells side by side until so many processes were killed."""
    seed, first, beginnings = int(figures.all["seed"]), figures.parts, BEGINNINGS
    with ThreadPoolExecutor(kills.CELLS) as pool:
        running: dict[Future[kills.Count], int] = {}
        while True:
            while len(running) < kills.CELLS and figures.kills < wanted and time.monotonic() < until_s:
                running[pool.submit(one_part, seed, first)] = first
                first += 1
            if not running:
                return
            for part in wait(running, return_when=FIRST_COMPLETED).done:
                number = running.pop(part)
                try:
                    count = part.result()
                except PolishdError as error:
                    say(f"crash: cell {number} did not begin, another one takes its place: {error}")
                    beginnings -= 1
                    if not beginnings:
                        raise
                    continue
                figures.add_kills(number, count)
                say(f"crash: {figures.kills} of {wanted} kills, wrong: {figures.all['kills']['bad'] or 'none'}")


def run_model(figures: Figures, faults: int) -> None:
    """Once for each text of it."""
    of = hashlib.sha256(model.MODEL.read_bytes()).hexdigest()[:16]
    if model.MISSING:
        say(f"crash: THE MODEL IS NOT CHECKED: {model.MISSING}; on Debian: apt-get install spin gcc")
    elif figures.all["model"].get("of") != of or figures.all["model"]["faults"] < faults:
        say(f"crash: checking the model with {faults} faults")
        held = [model.check(faults), model.check(faults, lives=True)]
        caught = [broken for broken in model.BROKEN if model.check(2, broken=broken).wrong]
        figures.add_model(of, faults, held, caught)


def one_part(seed: int, number: int) -> kills.Count:
    """Attack a cell in a new folder, which stays where something was wrong."""
    folder = Path(tempfile.mkdtemp(prefix="polishd-crash-"))
    count = attacks.part(folder / "cell", seed, number)
    if count.bad:
        say(f"crash: {count.examples}; see {folder}")
    else:
        shutil.rmtree(folder)
    return count


def main() -> int:
    """The exit code: 1 where anything was wrong."""
    parse = argparse.ArgumentParser(prog="make crash", description=__doc__)
    parse.add_argument("--states", type=int, default=STATES, help="different crash states in all")
    parse.add_argument("--kills", type=int, default=KILLS, help="killed processes in all")
    parse.add_argument("--faults", type=int, default=FAULTS, help="of the model; 0: it is not checked")
    parse.add_argument("--seed", type=int, default=1, help="another one begins anew")
    parse.add_argument("--minutes", type=float, default=1e9, help="of each in this session; what was begun is ended")
    parse.add_argument("--folder", type=Path, default=FOLDER, help="where figures are kept between sessions")
    parse.add_argument("--json", action="store_true", help="nothing but the last line, which is JSON in any case")
    options = parse.parse_args()
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # thousands of daemons would each compile polishd again
    folder = options.folder.resolve()  # strace prints whole paths
    figures = Figures(folder, options.seed)
    run_states(figures, options.states, time.monotonic() + 60 * options.minutes)
    run_kills(figures, options.kills, time.monotonic() + 60 * options.minutes)
    if options.faults:
        run_model(figures, options.faults)
    if folder == FOLDER and all(figures.all[name] for name in ("states", "kills", "model")):
        write_page(figures.all)
    found = figures.summary()
    if not options.json:
        print(table(figures.all))
    print(json.dumps(found))
    return int(any(found[name] for name in SAID))


if __name__ == "__main__":
    sys.exit(main())
