"""``make coverage``: every line and every branch of the proved modules is run by a test.

Which test runs which lines, and how long it takes, is kept in ``build/mutation`` for ``make mutate``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import coverage
import pytest

from tests.campaigns.mutation.scope import CHOSEN, KEPT, MODULES, ROOT, TESTS

LINES = KEPT / "lines.json"


class Contexts:
    """Of pytest: tells coverage which test runs, and counts the seconds of each."""

    def __init__(self, measured: coverage.Coverage) -> None:
        self._measured = measured
        self.of = content_of(MODULES)
        self.seconds: defaultdict[str, float] = defaultdict(float)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Setup and teardown are the test's, too."""
        self._measured.switch_context(item.nodeid)
        return (yield)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Of each of its three parts."""
        self.seconds[report.nodeid] += report.duration


def measure(tests: Sequence[str]) -> tuple[coverage.Coverage, Contexts, int]:
    """Run those tests with the modules watched; pytest's exit code, too. Nothing of polishd may be imported before."""
    include = [str(ROOT / name) for name in MODULES]
    measured = coverage.Coverage(data_file=None, branch=True, include=include, config_file=False)
    told = Contexts(measured)
    measured.start()
    try:
        code = pytest.main(["-q", "-m", CHOSEN, "-p", "no:cacheprovider", *tests], [told])
    finally:
        measured.stop()
    return measured, told, int(code)


def known_lines() -> dict[str, Any]:
    """What was kept of these modules: file of tests -> its hash, and of each test seconds and lines by module."""
    kept = json.loads(LINES.read_text()) if LINES.exists() else {}
    return kept["files"] if kept.get("of") == content_of(MODULES) else {}


def changed_tests() -> list[str]:
    """Files of tests that are other ones than those that were measured."""
    known = known_lines()
    found = [path for name in TESTS for path in sorted((ROOT / name).glob("test_*.py")) or [ROOT / name]]
    names = [str(path.relative_to(ROOT)) for path in found]
    return [name for name in names if known.get(name, {}).get("of") != content_of([name])]


def keep(measured: coverage.Coverage, told: Contexts) -> None:
    """Add what these tests run to what is known of others."""
    files = known_lines()
    tests: dict[str, Any] = {}
    for nodeid, seconds in told.seconds.items():
        tests[nodeid] = {"seconds": round(seconds, 4), "lines": defaultdict(list)}
    for module in MODULES:
        for line, contexts in measured.get_data().contexts_by_lineno(str(ROOT / module)).items():
            for nodeid in filter(None, contexts):
                tests[nodeid]["lines"][module].append(line)
    for name in {nodeid.partition("::")[0] for nodeid in tests}:
        own = {nodeid: test for nodeid, test in tests.items() if nodeid.startswith(f"{name}::")}
        files[name] = {"of": content_of([name]), "tests": own}
    KEPT.mkdir(parents=True, exist_ok=True)
    LINES.write_text(json.dumps({"of": told.of, "files": files}))


def content_of(names: Sequence[str]) -> str:
    """A hash of those files of the project."""
    content = hashlib.sha256()
    for name in names:
        path = ROOT / name
        content.update(path.read_bytes() if path.exists() else Path(name).name.encode())
    return content.hexdigest()[:16]


def main() -> int:
    """The exit code: pytest's, or 2 where a branch is not covered."""
    parse = argparse.ArgumentParser(prog="make coverage", description=__doc__)
    parse.add_argument("--changed", action="store_true", help="only tests that changed since, and no verdict")
    parse.add_argument("tests", nargs="*", help="of those only files with such names")
    options = parse.parse_args()
    tests = changed_tests() if options.changed else list(TESTS)
    tests = [name for name in tests if not options.tests or any(word in name for word in options.tests)]
    if not tests:
        return 0
    measured, told, code = measure(tests)
    if code:
        return code
    keep(measured, told)
    if options.changed:
        return 0
    percent = measured.report(show_missing=True, skip_covered=True, precision=2)
    return 0 if percent == 100.0 else 2


if __name__ == "__main__":
    sys.exit(main())
