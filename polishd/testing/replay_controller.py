"""Replay of a recorded controller that loads files: its variables and its file delivery.

async with replayed_controller(Path("case.wire.jsonl.gz"), "robot") as plc:
    robot = Handover("PLC", profile, plc.variables, plc)
    await robot.open()
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from polishd.api import DeviceIdentity, DeviceRefused, LinkError
from polishd.config.controller_profile import Value
from polishd.drivers.plc_robot.variables import DELIVERED, VariableSnapshot
from polishd.model.errors import ConfigError
from polishd.testing.replay import OWN_ENDS, RecordedExchange, ReplayScript
from polishd.util.wire_recording import WireMessage, read_recording

READ, BEAT = b"a reading", b"heartbeat"
CUT_OFF = "the recording ends here"

Numbered = Sequence[tuple[int, WireMessage]]


class ReplayVariableDialect:
    """A ReplayDialect of readings and writes; the value of a heartbeat is ignored."""

    def cut(self, data: bytes) -> int | None:
        """See ReplayDialect. Messages are always complete."""
        return len(data)

    def key(self, message: bytes) -> bytes:
        """See ReplayDialect."""
        return BEAT if message != READ and set(json.loads(message)) == {"heartbeat"} else message

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:  # noqa: ARG002 -- there is no number
        """See ReplayDialect."""
        return recorded


class RecordedController:
    """A controller from the recording. As ``Delivery`` it accepts the recorded files."""

    def __init__(self, name: str, variables: Numbered, files: Numbered) -> None:
        """``name`` for messages."""
        self._name = name
        self._files = _delivered(files)
        self._passed = dict(variables)
        self._ends: dict[int, str] = {}
        """End of the link after a record, by line."""
        found = self._exchanges()
        self._timed = frozenset({BEAT, *(one.out for one in found if _taken_back(one.out))})
        """Keys of writes that are due by time, independent of other commands."""
        self._script = ReplayScript(name, found, ReplayVariableDialect(), frozenset({READ, *self._timed}))
        self.mismatch: AssertionError | None = None
        """The first mismatch: the link is lost, and the block raises it."""

    def variables(self) -> Replayed:
        """Return a new, closed link."""
        return Replayed(self)

    async def put(self, name: str, text: bytes) -> None:  # noqa: ARG002 -- the dwells of its line check are random
        """See Delivery: replay the next recorded delivery of that name."""
        line, recorded, why = self._files.pop(0) if self._files else (0, "", "")
        if recorded != name:
            has = f"has {recorded!r} (line {line})" if recorded else "has no more files"
            raise self.differs(AssertionError(f"{self._name}: the driver delivered {name!r}; the recording {has}"))
        if why != DELIVERED:
            raise DeviceRefused(why)

    def differs(self, error: AssertionError) -> LinkError:
        """Record the mismatch; return the error to raise."""
        self.mismatch = self.mismatch or error
        return LinkError(str(error))

    def opened(self) -> str:
        """Return how the link was lost at the opening; empty if it was not."""
        exchange = self._script.opened()
        return CUT_OFF if exchange is None else self._ends.get(exchange.line, "")

    def is_early(self, message: bytes) -> bool:
        """Whether the message is recorded only later, and was due by the driver's clock."""
        return ReplayVariableDialect().key(message) in self._timed and not self._script.has(message)

    def asked(self, message: bytes) -> tuple[WireMessage, str]:
        """Return the recorded answer, and how the link was lost after it."""
        try:
            line = self._script.asked(message).line
        except AssertionError as error:
            raise self.differs(error) from error
        return self._passed[line], self._ends.get(line, "")

    def _exchanges(self) -> list[RecordedExchange]:
        found: list[RecordedExchange] = []
        for line, one in self._passed.items():
            if one.way == "end":
                if found and one.why not in OWN_ENDS:
                    self._ends[found[-1].line] = one.why
                continue
            out = {"open": b"", "in": READ}.get(one.way)
            found.append(RecordedExchange(line, one.at_s, _written(one.values or {}) if out is None else out))
        return found


class Replayed:
    """Variables of a recorded controller."""

    def __init__(self, controller: RecordedController) -> None:
        self._controller = controller
        self._lost = "is not open"

    async def open(self) -> None:
        """See Variables."""
        self._lost = self._controller.opened()
        self._require()

    async def close(self) -> None:
        """See Variables."""
        self._lost = "is not open"

    async def identify(self) -> DeviceIdentity:
        """See Variables. The identity is not recorded."""
        self._require()
        return DeviceIdentity("recorded", "controller", "", "")

    async def read(self) -> VariableSnapshot:
        """See Variables."""
        one = self._asked(READ)
        values = {
            name: value for name, value in (one.values or {}).items() if isinstance(value, bool | int | float | str)
        }
        return VariableSnapshot(one.at_s if one.clock_s is None else one.clock_s, values, one.changed_s or {})

    async def write(self, values: Mapping[str, Value]) -> None:
        """See Variables. The first heartbeat, or the reset of a command, may be due earlier than in the recording."""
        if self._controller.is_early(_written(values)):
            self._require()
        else:
            self._asked(_written(values))

    def _asked(self, message: bytes) -> WireMessage:
        self._require()
        one, self._lost = self._controller.asked(message)
        return one

    def _require(self) -> None:
        if self._lost:
            raise LinkError(self._lost)


@asynccontextmanager
async def replayed_controller(recording: Path, role: str) -> AsyncIterator[RecordedController]:
    """Replay the controller of a device during the block. Readings follow the driver's requests.

    Raises:
        ConfigError: The file or its device does not fit; with file and line.
        AssertionError: At the end of the block, if the driver wrote or delivered data that is not recorded; with both.
    """
    found = await asyncio.to_thread(read_recording, recording)
    passed = found.of(role)
    files = {one.link for _, one in passed if one.values is not None and "sha256" in one.values}
    variables = [(line, one) for line, one in passed if one.link not in files]
    if not any(one.values is not None for _, one in variables):
        raise ConfigError(f"{recording}: {role} is recorded as bytes, not as a controller's variables. Use replayed.")
    delivered = [(line, one) for line, one in passed if one.link in files]
    controller = RecordedController(f"{recording.name}, {role} on {variables[0][1].link}", variables, delivered)
    try:
        yield controller
    finally:
        if controller.mismatch is not None:
            raise controller.mismatch


def _delivered(files: Numbered) -> list[tuple[int, str, str]]:
    """Return (line, name, end) of each delivery."""
    found: list[tuple[int, str, str]] = []
    for line, one in files:
        if one.values is not None:
            found.append((line, str(one.values["file"]), CUT_OFF))
        elif one.way == "end" and found:
            found[-1] = (*found[-1][:2], one.why)
    return found


def _taken_back(out: bytes) -> bool:
    """Whether a write resets a command: one value, which is off."""
    values = json.loads(out) if out not in (b"", READ) else {}
    return len(values) == 1 and not any(values.values())


def _written(values: Mapping[str, object]) -> bytes:
    return json.dumps(dict(values)).encode()
