"""``make pits``: robots that stand or are slow and forces that are wrong, in contact, and the removal beyond plan.

Goes on where an earlier session ended: first with the cases that were never measured, then with those of other sources.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import sys
import tempfile
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path

from polishd.model.errors import PolishdError
from tests.campaigns.pits.cases import LINKS
from tests.campaigns.pits.judge import Finding, measure
from tests.campaigns.pits.kept import Kept, write
from tests.campaigns.result_files import first_line, side_by_side


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parse = argparse.ArgumentParser(prog="make pits", description=__doc__)
    parse.add_argument("--link", action="append", choices=LINKS, help="these alone")
    parse.add_argument("--fault", action="append", help="these alone, as the page names them")
    parse.add_argument("--again", action="store_true", help="those of these sources, too")
    parse.add_argument("--jobs", type=int, default=1, metavar="K", help="cells side by side; the rows name the load")
    parse.add_argument("--minutes", type=float, default=math.inf, help="of this sitting; what was begun is ended")
    parse.add_argument("--json", action="store_true", help="a JSON object a row on stdout, and nothing else")
    return parse


def tried(kept: Kept, case: tuple[str, str], *, as_json: bool) -> int:
    """1 where something was wrong: the cell's folder then stays."""
    folder = Path(tempfile.mkdtemp(prefix="polishd-pits-"))
    try:
        finding = measure(*case, folder / "cell")
    except (AssertionError, PolishdError) as error:
        say(f"{case[0]}: {case[1]}: not measured: {first_line(error)}; see {folder}", to_stderr=as_json)
        return 1
    kept.add(finding)
    say(json.dumps(asdict(finding)) if as_json else sentence(finding))
    if not finding.wrong:
        shutil.rmtree(folder)
    elif not as_json:
        say(f"  see {folder}")
    return int(bool(finding.wrong))


def sentence(one: Finding) -> str:
    """A row as people read it."""
    times = (
        "not noticed" if one.notice_s is None else f"noticed after {one.notice_s} s, no force after {one.no_force_s} s"
    )
    wrong = "".join(f"; WRONG: {said}" for said in one.wrong)
    return f"{one.link}: {one.fault}: {times}, {one.removed_nm} nm beyond plan, bound {one.bound_nm} nm{wrong}"


def say(text: str, *, to_stderr: bool = False) -> None:
    """Print it at once."""
    print(text, flush=True, file=sys.stderr if to_stderr else sys.stdout)


def main() -> int:
    """1 where something was wrong."""
    options = parser().parse_args()
    kept, until_s = Kept(), time.monotonic() + 60 * options.minutes
    wanted = [
        case
        for case in kept.left(again=options.again or bool(options.fault))
        if case[0] in (options.link or LINKS) and case[1] in (options.fault or [case[1]])
    ]
    work = [partial(tried, kept, case, as_json=options.json) for case in wanted]
    try:
        wrong = side_by_side(work, options.jobs, until_s)
    finally:
        write(kept)
    wrong += sum(bool(row["wrong"]) for row in kept.rows() if (row["link"], row["fault"]) not in wanted)
    say(f"{len(kept.left())} cases are left, {wrong} are not as required", to_stderr=options.json)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
