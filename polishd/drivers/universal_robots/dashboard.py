"""The dashboard server: a question, an answer, on a connection of their own. It is the way that needs no RTDE."""

from __future__ import annotations

import contextlib
import re
import time

from polishd.api import DeviceFault, DeviceRefused, LinkError, ProtocolError
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.streams import LineReader, open_stream

CONNECT_S = 0.8
ANSWER_S = 1.0
"""It lives in the pendant's user interface, which may be busy."""
GREETING = b"Connected: Universal Robots Dashboard Server"
_UNKNOWN = re.compile(r"could not understand|not supported", re.IGNORECASE)
_YES_OR_NO = re.compile(r"(?:[\w ]+: )?(true|false)", re.IGNORECASE | re.ASCII)
DASHBOARD_LINE_BYTES = 4096


async def ask(address: Tcp, question: str, within_s: float = ANSWER_S) -> str:
    """Ask once; empty where the controller is too old to know the question.

    LinkError where nobody answers in time, ProtocolError where another server does, DeviceRefused for a refusal.
    """
    stream = await open_stream(address, CONNECT_S)
    try:
        lines = LineReader(stream, DASHBOARD_LINE_BYTES)
        deadline = time.monotonic() + within_s
        greeting = await lines.next(max(deadline - time.monotonic(), 0.0))
        if not greeting.startswith(GREETING):
            raise ProtocolError(f"{address}: is no dashboard server: {greeting[:60]!r}")
        await stream.write(question.encode("ascii") + b"\n")
        answer = (await lines.next(max(deadline - time.monotonic(), 0.0))).decode("utf-8", "replace").strip()
    finally:
        await stream.close()
    return read(answer, question, str(address))


def read(answer: str, question: str, name: str) -> str:
    """What an answer says; empty for a question that is not known, DeviceRefused for an order that failed."""
    if _UNKNOWN.search(answer):
        return ""
    if answer.lower().startswith(("failed to execute", "error")):
        raise DeviceRefused(f"{name}: {question}: {answer}")
    return answer


def yes(answer: str) -> bool:
    """``true``, ``Program running: true``. ProtocolError where it is neither true nor false."""
    found = _YES_OR_NO.fullmatch(answer)
    if found is None:
        raise ProtocolError(f"dashboard: {answer[:60]!r} is neither true nor false")
    return found[1].lower() == "true"


async def in_remote_control(address: Tcp) -> bool:
    """Whether it takes programs over the network. Controllers without that mode (CB3) always do."""
    answer = await ask(address, "is in remote control")
    return not answer or yes(answer)


async def stop(address: Tcp, within_s: float) -> None:
    """Stop whatever runs, and see by its own word that nothing does. DeviceFault where that goes on."""
    with contextlib.suppress(DeviceRefused):  # it says so where nothing runs, too: what counts is whether anything does
        await ask(address, "stop", within_s)
    answer = await ask(address, "running", within_s)
    if not answer:
        raise LinkError(f"{address}: does not say whether a program runs")
    if yes(answer):
        raise DeviceFault(f"{address}: the program goes on running after stop")
