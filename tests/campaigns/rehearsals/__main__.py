"""``make rehearsals``: every example cell with a robot is rehearsed, and its part must reach its tolerance.

Each result is kept in docs/data, and the table in docs/reference/results.md is written from it.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from polishd.model.errors import PolishdError
from tests.campaigns.rehearsals.kept import Kept, write
from tests.campaigns.rehearsals.rehearse import cells, line, measure


def parser() -> argparse.ArgumentParser:
    """Parse the command line and run the rehearsals."""
    parse = argparse.ArgumentParser(prog="make rehearsals", description=__doc__)
    parse.add_argument("--cell", action="append", choices=cells(), help="these alone")
    parse.add_argument("--left", action="store_true", help="those that were not rehearsed with these sources")
    parse.add_argument("--json", action="store_true", help="a JSON object a row")
    return parse


def tried(kept: Kept, name: str, *, as_json: bool) -> int:
    """Keep the result. 1 where the part is not in tolerance: the folder then stays."""
    folder = Path(tempfile.mkdtemp(prefix="polishd-rehearsals-"))
    try:
        finding = measure(name, folder)
    except (AssertionError, PolishdError) as error:
        print(f"{name}: no rehearsal; see {folder}\n{error}", file=sys.stderr, flush=True)
        return 1
    kept.add(finding)
    write(kept)
    print(json.dumps(asdict(finding)) if as_json else line(finding), flush=True)
    if finding.is_accepted:
        shutil.rmtree(folder)
    else:
        print(f"{name}: see {folder}", file=sys.stderr, flush=True)
    return int(not finding.is_accepted)


def main() -> int:
    """1 where a part is not in tolerance."""
    options, kept = parser().parse_args(), Kept()
    names = options.cell or (kept.left() if options.left else cells())
    if not options.json:
        print(line(), flush=True)
    return int(sum(tried(kept, name, as_json=options.json) for name in names) > 0)


if __name__ == "__main__":
    sys.exit(main())
