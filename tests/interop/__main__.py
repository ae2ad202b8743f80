"""``python -m tests.interop``: all peers that are installed, and their table in docs/reference/interop.md."""

from __future__ import annotations

import sys

import pytest

from tests.interop.page import Tried, page, sentence_of
from tests.interop.peers import ROOT, Peer

PAGE = ROOT / "docs" / "reference" / "interop.md"


class Outcomes:
    """Plugin of pytest that records the result of each peer's tests."""

    def __init__(self) -> None:
        self.by_module: dict[str, Tried] = {}

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Which peers there are."""
        for item in session.items:
            peer = getattr(getattr(item, "module", None), "PEER", None)
            if isinstance(peer, Peer):
                self.by_module.setdefault(item.nodeid.partition("::")[0], Tried(peer, peer.version))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A test counts once: as failed wherever it failed."""
        module, _, name = report.nodeid.partition("::")
        tried, sentence = self.by_module.get(module), sentence_of(name)
        if tried is None:
            return
        if report.failed and sentence not in tried.failed:
            tried.failed.append(sentence)
            tried.passed = [other for other in tried.passed if other != sentence]
        elif report.skipped:
            tried.skipped[sentence] = _why(report)
        elif report.passed and report.when == "call":
            tried.passed.append(sentence)


def _why(report: pytest.TestReport) -> str:
    reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return reason.removeprefix("Skipped: ")


def main() -> int:
    """Pytest's exit code; the page is written whatever came of it, but only of a whole run."""
    outcomes = Outcomes()
    code = int(pytest.main(["tests/interop", *sys.argv[1:]], plugins=[outcomes]))
    tried = list(outcomes.by_module.values())
    if tried and code in {pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED} and len(sys.argv) == 1:
        from polishd.util.files import write_atomic  # pytest itself loads polishd, and wants to be the first

        debian = sorted({one.peer.package for one in tried if one.peer.source == "Debian"})
        write_atomic(PAGE, page(tried, debian).encode())
    missing = [one.peer.name for one in tried if not one.version]
    if missing:
        print(f"peers that are not installed: {', '.join(missing)}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
