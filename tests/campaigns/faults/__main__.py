"""``make faults``: every fault on every link in contact, and what came of it, into docs/reference/results.md.

Goes on where an earlier session ended, on whichever machine that was: first with the cases that were never measured,
then with those of other sources.
"""

from __future__ import annotations

import argparse
import math
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from polishd.model.errors import PolishdError
from tests.campaigns.faults.judge import Finding, measure
from tests.campaigns.faults.kept import LOSES, Kept
from tests.campaigns.faults.links import LINKS
from tests.campaigns.faults.losses import A_CELL, Loss, lose
from tests.campaigns.faults.page import write
from tests.campaigns.result_files import first_line, side_by_side

NOT_MEASURED = "not measured"
"""The cell did not come so far, or not to rest: no row of the page, and the next session tries again."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parse = argparse.ArgumentParser(prog="make faults", description=__doc__)
    parse.add_argument("--link", action="append", choices=LINKS, help="these alone")
    parse.add_argument("--fault", action="append", help="these alone, as the page names them")
    parse.add_argument("--new", action="store_true", help="none that has a row, of whatever sources")
    parse.add_argument("--again", action="store_true", help="those of these sources, too")
    parse.add_argument("--losses", type=int, default=0, metavar="N", help="instead: so many losses of each link in all")
    parse.add_argument("--jobs", type=int, default=1, metavar="K", help="cells side by side; the rows name the load")
    parse.add_argument("--minutes", type=float, default=math.inf, help="of this sitting; what was begun is ended")
    return parse


def tried(kept: Kept, link: str, fault: str) -> int:
    """Run it in a new folder, which stays where something was wrong; return whether something was."""
    folder = Path(tempfile.mkdtemp(prefix="polishd-faults-"))
    try:
        finding = measure(link, fault, folder / "cell")
    except (AssertionError, PolishdError) as error:
        wrong = [first_line(error)]
        finding = Finding(link, fault, "", None, LINKS[link].silence_s, None, NOT_MEASURED, wrong)
    else:
        kept.add(finding)
    say(f"{link}: {fault}: {finding.outcome}{_wrong(finding)}")
    _clear(folder, len(finding.wrong))
    return int(bool(finding.wrong))


def lost(kept: Kept, link: str, first: int, most: int, until_s: float) -> int:
    """So many losses of that link, kept as they come; of how many something is wrong."""
    folder = Path(tempfile.mkdtemp(prefix="polishd-losses-"))
    done = wrong = 0
    try:
        while done < most and time.monotonic() < until_s:
            for one in lose(link, first + done, most - done, folder / f"from-{first + done}", until_s):
                kept.add_loss(one)
                done += 1
                wrong += bool(one.wrong)
                times = f"{one.detection_s} s, force off {one.force_off_s} s"
                say(f"{link}: {first + done}: {one.how}: {times}{_wrong(one)}")
    except (AssertionError, PolishdError) as error:
        say(f"{link}: {first_line(error)}")
        wrong += 1
    _clear(folder, wrong)
    return wrong


def say(text: str) -> None:
    """Print it at once."""
    print(text, flush=True)


def _wrong(one: Finding | Loss) -> str:
    return "".join(f"; WRONG: {said}" for said in one.wrong)


def _clear(folder: Path, wrong: int) -> None:
    """A cell in which something is wrong is kept."""
    if wrong:
        say(f"  see {folder}")
    else:
        shutil.rmtree(folder)


def _work(options: argparse.Namespace, kept: Kept, until_s: float) -> list[Callable[[], int]]:
    """What is to be done, in its order."""
    links = options.link or list(LINKS)
    if not options.losses:
        left = kept.left(new=options.new, again=options.again)
        chosen = [case for case in left if case[0] in links and case[1] in (options.fault or [case[1]])]
        return [partial(tried, kept, *case) for case in chosen]
    return [
        partial(lost, kept, link, first, min(A_CELL, options.losses - first), until_s)
        for link in links
        if link in LOSES
        for first in range(kept.lost(link), options.losses, A_CELL)
    ]


def main() -> int:
    """1 where something was wrong."""
    options = parser().parse_args()
    kept, until_s = Kept(cells=options.jobs), time.monotonic() + 60 * options.minutes
    try:
        wrong = side_by_side(_work(options, kept, until_s), options.jobs, until_s)
    finally:
        write(kept)
    say(f"{len(kept.left(new=True))} cases were never measured, {len(kept.left())} not with these sources")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
