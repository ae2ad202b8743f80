"""The robot behind a Universal Robots controller: script up, RTDE for progress and orders, dashboard for the rest."""

from __future__ import annotations

import contextlib
import re
import secrets
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Field

from polishd.api import (
    DeviceContext,
    DeviceFault,
    DeviceIdentity,
    DeviceRefused,
    DeviceStatus,
    DeviceType,
    LinkError,
    Plan,
    ProtocolError,
    RobotTimes,
)
from polishd.config.fields import ConfigSection
from polishd.drivers.transport.address import Tcp, tcp_address
from polishd.drivers.transport.background import Background, Ready
from polishd.drivers.transport.claims import claim_address
from polishd.drivers.transport.program_robot import IsWanted, ProgramRobot
from polishd.drivers.transport.streams import LineReader, open_stream
from polishd.drivers.universal_robots.rtde import (
    RtdeConnection,
    RtdeSample,
    ScriptCommand,
    ScriptInputs,
    ScriptPhase,
    UrRegisters,
    UrRuntimeState,
)
from polishd.drivers.universal_robots.script import (
    LIVE,
    LONGEST_LINE,
    Settings,
    UrProgramTracker,
    assemble,
    blocks_of,
)
from polishd.util.address_claims import Claim

# The dashboard server: a question, an answer, on a connection of their own. It is the way that needs no RTDE.

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


# The primary client interface: scripts go up as text, and what the controller has to complain of comes back.

CONNECT_S = 0.8
PRIMARY_PACKET_BYTES = 1 << 20
BYTES_S, PIECE = 1e6, 1 << 16
"""A slow controller takes so many bytes a second."""
QUIET_S = 5.0
"""It tells its state ten times a second."""
_HEAD = struct.Struct(">iB")
_MESSAGE = struct.Struct(">QbB")
_WHERE = struct.Struct(">ii")
ROBOT_MESSAGE, RUNTIME_EXCEPTION = 20, 10


@dataclass(frozen=True, slots=True)
class ControllerMessage:
    """Why a script does not run."""

    line: int
    """1-based, of the script; 0 where it does not say."""
    text: str


class MessageReader:
    """Cuts the stream into messages and keeps the complaints."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> Iterator[ControllerMessage]:
        """The complaints in what is complete. ProtocolError where a length cannot be."""
        self._bytes += data
        while len(self._bytes) >= _HEAD.size:
            size, kind = _HEAD.unpack_from(self._bytes)
            if not _HEAD.size <= size <= PRIMARY_PACKET_BYTES:
                raise ProtocolError(f"primary interface: a message of {size} bytes")
            if len(self._bytes) < size:
                return
            payload = bytes(self._bytes[_HEAD.size : size])
            del self._bytes[:size]
            if kind == ROBOT_MESSAGE and (found := _complaint(payload)) is not None:
                yield found


def _complaint(payload: bytes) -> ControllerMessage | None:
    if len(payload) < _MESSAGE.size + _WHERE.size or _MESSAGE.unpack_from(payload)[2] != RUNTIME_EXCEPTION:
        return None
    line, _column = _WHERE.unpack_from(payload, _MESSAGE.size)
    text = payload[_MESSAGE.size + _WHERE.size :].decode("utf-8", "replace").strip("\0 \r\n")
    return ControllerMessage(max(line, 0), text)


class ScriptUpload(Background):
    """One script on its way; as a context it is sent, and listened to for complaints."""

    def __init__(self, address: Tcp, script: bytes) -> None:
        super().__init__(str(address))
        self._address = address
        self._script = script
        self.complaint: ControllerMessage | None = None
        """The first one."""

    async def __aenter__(self) -> Self:
        await self.start(self._run, CONNECT_S + len(self._script) / BYTES_S)
        return self

    async def __aexit__(self, *_error: object) -> None:
        await self.stop()

    async def _run(self, ready: Ready) -> None:
        stream = await open_stream(self._address, CONNECT_S)
        try:
            for at in range(0, len(self._script), PIECE):
                await stream.write(self._script[at : at + PIECE])
            ready()
            reader = MessageReader()
            while True:
                for complaint in reader.feed(await stream.read(1 << 16, QUIET_S)):
                    self.complaint = self.complaint or complaint
        finally:
            await stream.close()


LOAD_S, LOAD_LINE_S = 5.0, 5e-4
"""A script begins so long after it was sent, at most."""
SOFT_SHARE = 0.5
"""Of the time for a stop, for the program to stop itself; then the dashboard stops it."""


@dataclass(frozen=True, slots=True)
class Addresses:
    """The three servers of one controller that are used."""

    rtde: Tcp
    dashboard: Tcp
    primary: Tcp

    @classmethod
    def of(cls, host: str, rtde: int = 30004, dashboard: int = 29999, primary: int = 30001) -> Addresses:
        """On one host."""
        return cls(Tcp(host, rtde), Tcp(host, dashboard), Tcp(host, primary))


class UniversalRobot(ProgramRobot[UrProgramTracker]):
    """A Robot over RTDE. A lost link stays lost until ``open``; nothing but ``make_safe`` connects by itself.

    Never switches the robot on, releases no brake and unlocks no stop: that is for the operator, who stands there.
    """

    longest_line = LONGEST_LINE
    stops_anywhere = True

    def __init__(self, addresses: Addresses, settings: Settings, times: RobotTimes, rate_hz: float = 125.0) -> None:
        super().__init__(addresses.rtde.host, times)
        self._addresses = addresses
        self._settings = settings
        self._link = RtdeConnection(addresses.rtde, rate_hz, settings.registers, times.silence_s, self._seen)
        self._claimed: list[Claim] = []
        """On all of the controller's servers: those that are asked once are connected for that alone."""

    @property
    def _connection(self) -> RtdeConnection:
        return self._link

    @property
    def buffer_s(self) -> float:
        """See ProgramRobot. The program counts as there from when its script is sent."""
        return super().buffer_s if self._tracker is not None and self._tracker.token else 0.0

    async def open(self) -> None:
        """See Device. Gives no new order. What ran when the link was lost is followed further."""
        await self.close()
        self._stay()
        try:
            for address in (self._addresses.rtde, self._addresses.dashboard, self._addresses.primary):
                self._claimed.append(await claim_address(address))
            await self._link.open()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See Device."""
        await self._link.close()
        claimed, self._claimed = self._claimed, []
        for one in claimed:
            one.release()

    async def identify(self) -> DeviceIdentity:
        """See Device. Controllers from before 3.12 know neither model nor serial number."""
        self._link.check()
        model = await ask(self._addresses.dashboard, "get robot model")
        serial = await ask(self._addresses.dashboard, "get serial number")
        return DeviceIdentity("Universal Robots", model or "UR", serial or "unknown", self._link.controller)

    async def status(self) -> DeviceStatus:
        """See Device. Ready: it would take a program and run it as written. Safe: nothing runs and it stands."""
        sample = self._link.last
        why = sample.obstacle() or await self._not_remote()
        state = (
            UrRuntimeState(sample.runtime).name.lower()
            if sample.runtime in tuple(UrRuntimeState)
            else str(sample.runtime)
        )
        return DeviceStatus(ready=not why, safe=self._link.stands, state=state, detail=why)

    async def hold(self) -> None:
        """See Robot. The program brakes along the path and ends; ``resume`` continues it from where it stands."""
        self._link.check()
        self._stay()
        await self._stop()

    async def lift(self, distance_mm: float) -> None:
        """See Robot. Out of the motion, by a branch of our own program: so there must be one under way."""
        link, tracker = self._link, self._tracker
        if tracker is None or not self._hears(link.last):
            raise DeviceRefused(f"{self._name}: no program of ours is under way that could lift")
        self._stay()
        await link.tell(ScriptInputs(tracker.token, tracker.until, ScriptCommand.LIFT, round(distance_mm * 1000.0)))
        await link.until(lambda: not self._hears(link.last) and link.last.phase != ScriptPhase.ENDS, self._times.stop_s)
        tracker.drop("lifted off the path")
        if link.last.phase != ScriptPhase.LIFTED:
            raise DeviceFault(f"{self._name}: the robot does not lift: {link.last.obstacle() or 'no reason is told'}")
        await link.standstill("the lift", self._times.stop_s)

    async def _clear(self) -> None:
        if why := self._link.last.obstacle() or await self._not_remote():
            raise DeviceRefused(f"{self._name}: {why}. Correct it at the robot, then try again")
        await self._stop()

    def _track(self, plan: Plan, blocks: int) -> UrProgramTracker:
        return UrProgramTracker(plan, blocks)

    def _has_to_load(self, tracker: UrProgramTracker) -> bool:
        return not tracker.live

    async def _load(self, plan: Plan, tracker: UrProgramTracker) -> None:
        """Send what is left of the program, and see that it waits. DeviceRefused where it cannot be followed."""
        del plan
        blocks = blocks_of(self._lines)
        token = secrets.randbelow((1 << 31) - 1) + 1
        script = assemble(blocks, len(tracker), tracker.spent_s, token, self._settings)
        tracker.sent(token, blocks)
        await self._link.tell(ScriptInputs(token))
        within_s = LOAD_S + LOAD_LINE_S * len(script.block_of)
        async with ScriptUpload(self._addresses.primary, script.text) as upload:

            def is_answered() -> bool:
                upload.check()
                return tracker.live or upload.complaint is not None

            taken = await self._link.until(is_answered, within_s)
        if upload.complaint is not None:
            where, text = script.names(upload.complaint.line), upload.complaint.text
            raise DeviceRefused(f"{self._name}: the controller does not take {where}: {text}")
        if not taken:
            raise DeviceRefused(f"{self._name}: the controller did not start the script within {within_s:g} s")

    async def _run(self, tracker: UrProgramTracker, wanted: IsWanted) -> None:
        """To the target."""
        if wanted(self._link.last.time_s):
            tracker.until = tracker.blocks if self._target is None else self._target
            await self._link.tell(ScriptInputs(tracker.token, tracker.until))

    async def _stop(self) -> None:
        """A program of the driver by its own command, any other by the dashboard."""
        link, tracker, stop_s = self._link, self._tracker, self._times.stop_s
        if tracker is not None and self._hears(link.last):
            await link.tell(ScriptInputs(tracker.token, 0, ScriptCommand.STOP))
            await link.until(lambda: link.stands, SOFT_SHARE * stop_s)
        if link.last.runtime != UrRuntimeState.STOPPED:
            await stop(self._addresses.dashboard, stop_s)
        await link.standstill("stop", stop_s)

    async def _stop_anew(self) -> None:
        await stop(self._addresses.dashboard, self._times.stop_s)

    async def _seen(self, sample: RtdeSample) -> None:
        """Record what the controller does; a program that is over gets no more heartbeats."""
        tracker = self._tracker
        if tracker is None:
            return
        tracker.update(sample)
        if tracker.heard and not (sample.token == tracker.token and sample.phase in (*LIVE, ScriptPhase.ENDS)):
            self._link.orders = None

    def _hears(self, sample: RtdeSample) -> bool:
        """The program of the driver takes commands."""
        ours = self._tracker is not None and sample.token == self._tracker.token and sample.phase in LIVE
        return ours and sample.runtime == UrRuntimeState.PLAYING

    def _obstacle(self) -> str:
        sample, tracker = self._link.last, self._tracker
        if why := sample.obstacle():
            return why
        if tracker is not None and tracker.live and sample.runtime in (UrRuntimeState.PAUSING, UrRuntimeState.PAUSED):
            return "the program is paused at the controller: continue it there, or prepare it anew"
        return ""

    async def _not_remote(self) -> str:
        remote = await in_remote_control(self._addresses.dashboard)
        return "" if remote else "it is in local control: switch it to remote control at the pendant"

    def _override(self) -> float:
        return self._link.last.override

    def _moves(self) -> bool:
        return self._link.last.plays

    def _running(self) -> bool:
        tracker = self._tracker
        return tracker.state == "running" if tracker is not None and tracker.live else self._moves()

    def _drop(self) -> None:
        self._link.orders = None
        super()._drop()


# The device type ``universal_robots``: a robot on a Universal Robots controller (docs/universal-robots.md).

WAY_S = 0.02
"""Longest that a sample is under way."""
Port = Annotated[int, Field(ge=1, le=65535)]


class UniversalRobotsOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "universal_robots"``."""

    address: str
    """RTDE of the controller: ``tcp://host:30004``."""
    dashboard_port: Port = 29999
    """TCP port of its dashboard server. [1]"""
    primary_port: Port = 30001
    """TCP port of its primary client interface, which takes scripts. [1]"""
    rate_hz: Annotated[float, Field(ge=10.0, le=500.0)] = 125.0
    """How often the controller tells where it is: a block's end is known to one period. e-Series: up to 500. [Hz]"""
    first_register: Annotated[int, Field(ge=0, le=43)] = 24
    """Of the controller's integer registers, five inputs and four outputs from here on are polishd's. [1]"""
    tool_z: Literal["into_part", "out_of_part"] = "into_part"
    """Where the tool frame's z points: a lift goes the other way. As in the program's dialect."""
    watchdog_s: Annotated[float, Field(gt=0.0, le=600.0)] = 8.0
    """So long without a word from us the controller stops the program."""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = 1.0
    """No sample for so long: the link is lost, and contact is left."""
    stop_s: Annotated[float, Field(gt=0.0, le=60.0)] = 5.0
    """Longest that it takes to stop, or to lift the tool off."""


def _build(options: UniversalRobotsOptions, context: DeviceContext) -> UniversalRobot:
    address = tcp_address(options.address, context.base_dir, "universal_robots")
    report_s = 2.0 / options.rate_hz + WAY_S
    times = RobotTimes(options.silence_s, options.watchdog_s, options.stop_s, report_s=report_s)
    addresses = Addresses.of(address.host, address.port, options.dashboard_port, options.primary_port)
    settings = Settings(UrRegisters(options.first_register), options.watchdog_s, options.tool_z == "into_part")
    return UniversalRobot(addresses, settings, times, options.rate_hz)


def _takes(blocks: Sequence[bytes]) -> str:
    """URScript is its only language."""
    try:
        blocks_of(blocks)
    except DeviceRefused as refusal:
        return str(refusal)
    return ""


DEVICE_TYPES = [
    DeviceType(
        "universal_robots",
        "robot",
        UniversalRobotsOptions,
        _build,
        _takes,
        program_format="urscript",
        simulated_by="universal_robots",
        simulation_speed=4.0,
        usual_address="tcp://robot-controller:30004",
    )
]
