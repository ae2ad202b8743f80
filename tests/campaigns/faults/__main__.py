"""``make faults``: every fault on every link in contact, and what came of it, into docs/fault-matrix.md."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from pathlib import Path

from tests.campaigns.faults.judge import Finding, measure, save
from tests.campaigns.faults.links import LINKS
from tests.campaigns.faults.losses import Loss, keep, lose
from tests.campaigns.faults.page import SAVED, write

NOT_MEASURED = "not measured"
"""The cell did not come so far, or not to rest: no row of the page, and the next run with --new tries again."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parse = argparse.ArgumentParser(prog="faults", description=__doc__)
    parse.add_argument("--link", action="append", choices=LINKS, help="these alone")
    parse.add_argument("--fault", action="append", help="these alone, as the page names them")
    parse.add_argument("--new", action="store_true", help="only those that are not saved yet")
    parse.add_argument("--losses", type=int, default=0, metavar="N", help="instead: so many losses of each link")
    return parse


def tried(link: str, fault: str) -> Finding:
    """In a folder of its own, which stays where something is wrong."""
    folder = Path(tempfile.mkdtemp(prefix="polishd-faults-"))
    try:
        finding = measure(link, fault, folder / "cell")
    except AssertionError as error:
        wrong = [str(error).splitlines()[0]]
        finding = Finding(link, fault, "", None, LINKS[link].silence_s, None, NOT_MEASURED, wrong)
    say(f"{link}: {fault}: {finding.outcome}{''.join(f'; WRONG: {one}' for one in finding.wrong)}")
    if finding.wrong:
        say(f"  the cell is in {folder}")
    else:
        shutil.rmtree(folder)
    return finding


def lost(link: str, count: int) -> int:
    """Losses of that link, saved as they come; of how many something is wrong."""
    folder = Path(tempfile.mkdtemp(prefix="polishd-losses-"))
    found: list[Loss] = []
    try:
        for one in lose(link, count, folder):
            found.append(one)
            keep(found, SAVED / f"{''.join(letter if letter.isalnum() else '-' for letter in link)}.losses")
            wrong = "".join(f"; WRONG: {said}" for said in one.wrong)
            say(
                f"{link}: {len(found)} of {count}: {one.how}: {one.detection_s} s, force off {one.force_off_s} s{wrong}"
            )
    except AssertionError as error:
        say(f"{link}: {str(error).splitlines()[0]}; the cell is in {folder}")
        return 1
    wrong_ones = sum(bool(one.wrong) for one in found)
    if wrong_ones:
        say(f"{link}: the cells are in {folder}")
    else:
        shutil.rmtree(folder)
    return wrong_ones


def say(text: str) -> None:
    """At once, whoever reads."""
    print(text, flush=True)


def main() -> int:
    """1 where something was wrong."""
    options = parser().parse_args()
    wrong = 0
    saved = {(one["link"], one["fault"]) for one in _saved()} if options.new else set()
    for name in options.link or LINKS:
        if options.losses:
            if not LINKS[name].needed or not {"hangs", "unplugged"} <= LINKS[name].faults.keys():
                continue
            wrong += lost(name, options.losses)
            continue
        for fault in LINKS[name].faults:
            if (options.fault and fault not in options.fault) or (name, fault) in saved:
                continue
            finding = tried(name, fault)
            if finding.outcome != NOT_MEASURED:
                save(finding, SAVED)
            wrong += bool(finding.wrong)
    write()
    return int(wrong > 0)


def _saved() -> list[dict[str, str]]:
    return [json.loads(path.read_text()) for path in SAVED.glob("*.json")]


if __name__ == "__main__":
    sys.exit(main())
