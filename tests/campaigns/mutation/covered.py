"""``make coverage``: tests run every line and every branch of the safety-relevant modules.

The lines and the time of each test are kept in ``build/mutation`` for ``make mutate``.
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
    """Plugin of pytest that gives coverage the running test, and adds up the seconds of each test."""

    def __init__(self, measured: coverage.Coverage) -> None:
        self._measured = measured
        self.of = content_of(MODULES)
        self.seconds: defaultdict[str, float] = defaultdict(float)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Set the context before a test: setup and teardown belong to the test."""
        self._measured.switch_context(item.nodeid)
        return (yield)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add the time of setup, call or teardown."""
        self.seconds[report.nodeid] += report.duration


def measure(tests: Sequence[str]) -> tuple[coverage.Coverage, Contexts, int]:
    """Run tests with coverage of the modules and return pytest's exit code, too. polishd must not be imported yet."""
    include = [str(ROOT / name) for name in MODULES]
    measured = coverage.Coverage(data_file=None, branch=True, include=include, config_file=False)
    contexts = Contexts(measured)
    measured.start()
    try:
        code = pytest.main(["-q", "-m", CHOSEN, "-p", "no:cacheprovider", *tests], [contexts])
    finally:
        measured.stop()
    return measured, contexts, int(code)


def known_lines() -> dict[str, Any]:
    """Return the saved lines: by test file its hash, and of each test seconds and lines by module."""
    kept = json.loads(LINES.read_text()) if LINES.exists() else {}
    return kept["files"] if kept.get("of") == content_of(MODULES) else {}


def changed_tests() -> list[str]:
    """Return the test files that changed since they were measured."""
    known = known_lines()
    found = [path for name in TESTS for path in sorted((ROOT / name).rglob("test_*.py")) or [ROOT / name]]
    names = [str(path.relative_to(ROOT)) for path in found]
    return [name for name in names if known.get(name, {}).get("of") != content_of([name])]


def keep(measured: coverage.Coverage, contexts: Contexts) -> None:
    """Save the lines that these tests run together with those of other tests."""
    files = known_lines()
    tests: dict[str, Any] = {}
    for nodeid, seconds in contexts.seconds.items():
        tests[nodeid] = {"seconds": round(seconds, 4), "lines": defaultdict(list)}
    for module in MODULES:
        for line, nodeids in measured.get_data().contexts_by_lineno(str(ROOT / module)).items():
            for nodeid in filter(None, nodeids):
                tests[nodeid]["lines"][module].append(line)
    for name in {nodeid.partition("::")[0] for nodeid in tests}:
        own = {nodeid: test for nodeid, test in tests.items() if nodeid.startswith(f"{name}::")}
        files[name] = {"of": content_of([name]), "tests": own}
    KEPT.mkdir(parents=True, exist_ok=True)
    LINES.write_text(json.dumps({"of": contexts.of, "files": files}))


def content_of(names: Sequence[str]) -> str:
    """Return the hash of these files of the project."""
    content = hashlib.sha256()
    for name in names:
        path = ROOT / name
        content.update(path.read_bytes() if path.exists() else Path(name).name.encode())
    return content.hexdigest()[:16]


def main() -> int:
    """Measure the coverage and return the exit code: pytest's, or 2 where a branch is not covered."""
    parse = argparse.ArgumentParser(prog="make coverage", description=__doc__)
    parse.add_argument("--changed", action="store_true", help="only tests that changed since, and no verdict")
    parse.add_argument("tests", nargs="*", help="of those only files with such names")
    options = parse.parse_args()
    tests = changed_tests() if options.changed else list(TESTS)
    tests = [name for name in tests if not options.tests or any(word in name for word in options.tests)]
    if not tests:
        return 0
    measured, contexts, code = measure(tests)
    if code:
        return code
    keep(measured, contexts)
    if options.changed:
        return 0
    percent = measured.report(show_missing=True, skip_covered=True, precision=2)
    return 0 if percent == 100.0 else 2


if __name__ == "__main__":
    sys.exit(main())
