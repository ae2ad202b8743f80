"""Write docs/reference/interop.md: the peers with their versions, the tests with them, and the results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from tests.interop.peers import LINKS, Peer

HEAD = """# Interoperability: peers of other authors

<!-- Written by `make interop`. -->

This page lists the programs and libraries of other authors with which each link and each simulated device of polishd
was tested. A test of a library against its own server proves nothing, so each row states which end the peer was;
polishd was the other. polishd's driver tested a server, a slave or a node; a client or a master tested polishd's
simulated device. For ADS and CANopen the driver and the server use the same library (pyads, canopen): there the test
only shows that polishd uses it correctly.

`make interop` fetches the peers of PyPI and npm ([requirements.txt](../../tests/interop/requirements.txt),
[package.json](../../tests/interop/package.json)) into `build/interop`, runs `tests/interop` and writes this page.
An administrator must install those of Debian. A missing peer is skipped by its name.

    apt-get install DEBIAN
"""
FOOT = """
The rows have the names of the tests in `tests/interop`, in the file of each peer. Not tested: a real PLC, a
real inverter, TwinCAT's own router, OPC UA with certificates.
"""


@dataclass(slots=True)
class Tried:
    """Results of a peer's tests by name; ``why`` is the reason where the peer was skipped."""

    peer: Peer
    version: str
    passed: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)

    @property
    def outcome(self) -> str:
        """In a word or two."""
        if self.failed:
            return f"**{len(self.failed)} of {len(self.failed) + len(self.passed)} failed**"
        if self.passed:
            return "passed"
        if not self.version:
            return "skipped: not installed"
        return "skipped: " + ", ".join(sorted(set(self.skipped.values())) or ["not run"])


def page(tried: Sequence[Tried], debian: Sequence[str]) -> str:
    """The page; the same of the same outcomes."""
    rows = ["| link | peer | it is | version | tried | |", "|---|---|---|---|---|---|"]
    rows += [_row(one) for one in sorted(tried, key=_order)]
    return HEAD.replace("DEBIAN", " ".join(debian)) + "\n" + "\n".join(rows) + "\n" + FOOT


def _order(one: Tried) -> tuple[int, str]:
    return LINKS.index(one.peer.link), one.peer.name.lower()


def _row(one: Tried) -> str:
    names = [*one.passed, *(f"**{name}**" for name in one.failed), *one.skipped]
    version = f"{one.version} ({one.peer.source})" if one.version else one.peer.source
    cells = (one.peer.link, one.peer.name, one.peer.part, version, "; ".join(names), one.outcome)
    return f"| {' | '.join(cells)} |"


def sentence_of(name: str) -> str:
    """A test's name as a sentence: without its prefix, its case behind a colon."""
    plain, _, case = name.removeprefix("test_").partition("[")
    return plain.replace("_", " ") + (f": {case.rstrip(']')}" if case else "")
