"""Compare jobs of a study on the present sources and on those of a commit: ``python -m tests.campaigns.same_jobs``.

A change of a message or of a map reader makes the figures of a study old, and hours are too much for each. Where the
first jobs of the study end with the same figures to the bit on both, its claims go on, and say so. A claim that was not
measured on the sources of that commit stays as it is.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from pyarrow.parquet import read_table

from tests.campaigns import claims, result_files

OF_THE_RUN = {"cpu_s", "wall_s", "tries", "of", "versions", "why"}
"""Keys of a case that no figure of a page is made of: times of the computer, labels, and texts for people."""
THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def figures_of(folder: Path) -> list[dict[str, Any]]:
    """Return the rows of a study without what belongs to its run."""
    rows = sorted(read_table(folder / "cases.parquet").to_pylist(), key=lambda row: int(row["case"]))
    return [{key: value for key, value in row.items() if key not in OF_THE_RUN} for row in rows]


def differences(then: Sequence[Mapping[str, Any]], now: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield each figure that differs, NaN as itself."""
    if len(then) != len(now):
        yield f"{len(then)} rows then, {len(now)} now"
    for old, new in zip(then, now, strict=False):
        for key in sorted(old.keys() | new.keys()):
            if json.dumps(old.get(key)) != json.dumps(new.get(key)):
                yield f"case {old.get('case')}: {key}: {old.get(key)} then, {new.get(key)} now"


def continued(
    all_claims: Sequence[claims.Claim], names: Sequence[str], base: Path, how: str, root: Path = claims.ROOT
) -> list[claims.Claim]:
    """Return the claims with those of that names continued on the present sources.

    ValueError for one that was not measured on the sources in ``base``.
    """
    found = {one.claim: one for one in all_claims}
    for name in names:
        if name not in found or found[name].of != result_files.sources(found[name].scope, base):
            raise ValueError(f"{name} was not measured on the sources of that commit. Measure it again.")
        one = found[name]
        found[name] = replace(one, of=result_files.sources(one.scope, root), same=how)
    return list(found.values())


@contextmanager
def checked_out(commit: str) -> Iterator[Path]:
    """The files of a commit, in a folder that is removed at the end."""
    with tempfile.TemporaryDirectory(prefix="polishd-same-") as folder:
        tree = Path(folder) / "tree"
        subprocess.run(["git", "worktree", "add", "-q", "--detach", tree, commit], cwd=claims.ROOT, check=True)
        try:
            yield tree
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", tree], cwd=claims.ROOT, check=True)


def run(tree: Path, study: str, out: Path, jobs: int) -> list[dict[str, Any]]:
    """Run the first jobs of a study on the sources of that folder."""
    command = [sys.executable, "-m", "polishd", "study", f"examples/{study}.toml", "--out", str(out)]
    command += ["--limit", str(jobs), "--workers", "1"]
    subprocess.run(
        command, cwd=tree, env=os.environ | THREADS | {"PYTHONPATH": str(tree)}, stdout=subprocess.DEVNULL, check=True
    )
    return figures_of(out)


def main() -> int:
    """Return the exit code: 1 where a figure differs; then no claim is changed."""
    parse = argparse.ArgumentParser(prog="python -m tests.campaigns.same_jobs", description=__doc__)
    parse.add_argument("study", help="of examples/, without its ending")
    parse.add_argument("claims", nargs="+", help="that are made of it")
    parse.add_argument("--base", required=True, metavar="COMMIT", help="on whose sources they were measured")
    parse.add_argument("--jobs", type=int, default=24, help="that are compared")
    options = parse.parse_args()
    with checked_out(options.base) as base, tempfile.TemporaryDirectory(prefix="polishd-jobs-") as folder:
        continued(claims.read(), options.claims, base, "")  # before hours of work
        then, now = (run(tree, options.study, Path(folder) / tree.name, options.jobs) for tree in (base, claims.ROOT))
        if found := list(differences(then, now)):
            print("\n".join(found), file=sys.stderr)
            return 1
        how = f"{len(now)} rows of {options.study} as at {options.base[:8]}, to the bit, {result_files.today()}"
        claims.write(continued(claims.read(), options.claims, base, how))
    print(f"{', '.join(options.claims)}: {how}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
