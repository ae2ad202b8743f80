"""Driver of a Universal Robots controller: script upload, RTDE for progress and commands, dashboard for the rest."""

from __future__ import annotations

import contextlib
import re
import secrets
import struct
import time
from collections.abc import Awaitable, Callable, Iterator, Sequence
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

# The dashboard server: one request per connection. It works without RTDE.

CONNECT_S = 0.8
ANSWER_S = 1.0
"""Longest wait: the server runs in the pendant's user interface, which may be busy."""
GREETING = b"Connected: Universal Robots Dashboard Server"
_UNKNOWN = re.compile(r"could not understand|not supported", re.IGNORECASE)
_YES_OR_NO = re.compile(r"(?:[\w ]+: )?(true|false)", re.IGNORECASE | re.ASCII)
DASHBOARD_LINE_BYTES = 4096


async def ask(address: Tcp, question: str, within_s: float = ANSWER_S) -> str:
    """Send one request; return an empty text if the controller is too old to know it.

    LinkError without an answer in time, ProtocolError if another server answers, DeviceRefused for a refusal.
    """
    stream = await open_stream(address, CONNECT_S)
    try:
        lines = LineReader(stream, DASHBOARD_LINE_BYTES)
        deadline = time.monotonic() + within_s
        greeting = await lines.next(max(deadline - time.monotonic(), 0.0))
        if not greeting.startswith(GREETING):
            raise ProtocolError(f"{address}: is not a dashboard server: {greeting[:60]!r}")
        await stream.write(question.encode("ascii") + b"\n")
        answer = (await lines.next(max(deadline - time.monotonic(), 0.0))).decode("utf-8", "replace").strip()
    finally:
        await stream.close()
    return read(answer, question, str(address))


def read(answer: str, question: str, name: str) -> str:
    """Parse an answer; empty for an unknown request, DeviceRefused for a failed command."""
    if _UNKNOWN.search(answer):
        return ""
    if answer.lower().startswith(("failed to execute", "error")):
        raise DeviceRefused(f"{name}: {question}: {answer}")
    return answer


def yes(answer: str) -> bool:
    """Parse ``true`` or ``Program running: true``. ProtocolError if it is neither true nor false."""
    found = _YES_OR_NO.fullmatch(answer)
    if found is None:
        raise ProtocolError(f"dashboard: {answer[:60]!r} is neither true nor false")
    return found[1].lower() == "true"


async def in_remote_control(address: Tcp) -> bool:
    """Whether the controller accepts programs over the network. Controllers without that mode (CB3) always do."""
    answer = await ask(address, "is in remote control")
    return not answer or yes(answer)


async def stop(address: Tcp, within_s: float) -> None:
    """Stop any program and confirm that none runs. DeviceFault if one still runs."""
    with contextlib.suppress(DeviceRefused):  # also refused if no program runs: the state decides
        await ask(address, "stop", within_s)
    answer = await ask(address, "running", within_s)
    if not answer:
        raise LinkError(f"{address}: does not report whether a program runs")
    if yes(answer):
        raise DeviceFault(f"{address}: the program still runs after stop")


# The primary client interface: it accepts scripts as text and sends the controller's error messages.

CONNECT_S = 0.8
PRIMARY_PACKET_BYTES = 1 << 20
BYTES_S, PIECE = 1e6, 1 << 16
"""Upload rate of a slow controller, bytes/s."""
QUIET_S = 5.0
"""The interface sends its state ten times a second."""
_HEAD = struct.Struct(">iB")
_MESSAGE = struct.Struct(">QbB")
_WHERE = struct.Struct(">ii")
ROBOT_MESSAGE, RUNTIME_EXCEPTION = 20, 10


@dataclass(frozen=True, slots=True)
class ControllerMessage:
    """Reason why a script does not run."""

    line: int
    """Line of the script, 1-based; 0 if unknown."""
    text: str


class MessageReader:
    """Splits the stream into messages and keeps the errors."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> Iterator[ControllerMessage]:
        """Add bytes; yield the errors in complete messages. ProtocolError for an impossible length."""
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
    """Upload of a script; as a context it sends the script and receives errors."""

    def __init__(self, address: Tcp, script: bytes) -> None:
        super().__init__(str(address))
        self._address = address
        self._script = script
        self.complaint: ControllerMessage | None = None
        """The first error."""

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
"""Longest time from sending a script to its start."""
SOFT_SHARE = 0.5
"""Share of the stop time for the program to stop itself; then the dashboard stops it."""


@dataclass(frozen=True, slots=True)
class Addresses:
    """Addresses of the three servers of one controller."""

    rtde: Tcp
    dashboard: Tcp
    primary: Tcp

    @classmethod
    def of(cls, host: str, rtde: int = 30004, dashboard: int = 29999, primary: int = 30001) -> Addresses:
        """Return the addresses on one host."""
        return cls(Tcp(host, rtde), Tcp(host, dashboard), Tcp(host, primary))


class UniversalRobot(ProgramRobot[UrProgramTracker]):
    """A Robot over RTDE. A lost link stays lost until ``open``; only ``make_safe`` reconnects.

    It never switches the robot on, releases a brake or unlocks a stop: the operator does that at the robot.
    """

    longest_line = LONGEST_LINE
    stops_anywhere = True

    def __init__(self, addresses: Addresses, settings: Settings, times: RobotTimes, rate_hz: float = 125.0) -> None:
        super().__init__(addresses.rtde.host, times)
        self._addresses = addresses
        self._settings = settings
        self._rate_hz = rate_hz
        self._link = self._make_connection(self._seen)
        self._claimed: list[Claim] = []
        """Claims on all servers of the controller; the dashboard is connected for each request only."""

    @property
    def _connection(self) -> RtdeConnection:
        return self._link

    def _make_connection(
        self, on_sample: Callable[[RtdeSample], Awaitable[None]], *, has_inputs: bool = True
    ) -> RtdeConnection:
        registers, silence_s = self._settings.registers, self._times.silence_s
        return RtdeConnection(
            self._addresses.rtde, self._rate_hz, registers, silence_s, on_sample, has_inputs=has_inputs
        )

    @property
    def buffer_s(self) -> float:
        """See ProgramRobot. The program counts as loaded once its script is sent."""
        return super().buffer_s if self._tracker is not None and self._tracker.token else 0.0

    async def open(self) -> None:
        """See Device. Sends no new command. Continues to track a program that ran when the link was lost."""
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
        """See Device. Controllers before 3.12 report neither model nor serial number."""
        self._link.check()
        model = await ask(self._addresses.dashboard, "get robot model")
        serial = await ask(self._addresses.dashboard, "get serial number")
        return DeviceIdentity("Universal Robots", model or "UR", serial or "unknown", self._link.controller)

    async def status(self) -> DeviceStatus:
        """See Device. Ready: it would run a program as written. Safe: no program runs, and standstill."""
        sample = self._link.last
        why = sample.obstacle() or await self._not_remote()
        state = (
            UrRuntimeState(sample.runtime).name.lower()
            if sample.runtime in tuple(UrRuntimeState)
            else str(sample.runtime)
        )
        return DeviceStatus(ready=not why, safe=self._link.stands, state=state, detail=why)

    async def hold(self) -> None:
        """See Robot. The program brakes along the path and ends; ``resume`` continues from there."""
        self._link.check()
        self._stay()
        await self._stop()

    async def lift(self, distance_mm: float) -> None:
        """See Robot. A branch of our running program lifts out of the motion: so a program must run."""
        link, tracker = self._link, self._tracker
        if tracker is None or not self._hears(link.last):
            raise DeviceRefused(f"{self._name}: no program of polishd runs that could lift")
        self._stay()
        await link.tell(ScriptInputs(tracker.token, tracker.until, ScriptCommand.LIFT, round(distance_mm * 1000.0)))
        await link.until(lambda: not self._hears(link.last) and link.last.phase != ScriptPhase.ENDS, self._times.stop_s)
        tracker.drop("lifted off the path")
        if link.last.phase != ScriptPhase.LIFTED:
            raise DeviceFault(f"{self._name}: the robot does not lift: {link.last.obstacle() or 'unknown reason'}")
        await link.standstill("the lift", self._times.stop_s)

    async def _clear(self) -> None:
        if why := self._link.last.obstacle() or await self._not_remote():
            raise DeviceRefused(f"{self._name}: {why}. Correct it at the robot, then try again.")
        await self._stop()

    def _track(self, plan: Plan, blocks: int) -> UrProgramTracker:
        return UrProgramTracker(plan, blocks)

    def _has_to_load(self, tracker: UrProgramTracker) -> bool:
        return not tracker.live

    async def _load(self, plan: Plan, tracker: UrProgramTracker) -> None:
        """Send the rest of the program and wait until it is ready. DeviceRefused if it cannot be tracked."""
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
            raise DeviceRefused(f"{self._name}: the controller refuses {where}: {text}")
        if not taken:
            raise DeviceRefused(f"{self._name}: the controller did not start the script within {within_s:g} s")

    async def _run(self, tracker: UrProgramTracker, wanted: IsWanted) -> None:
        """Run to the target."""
        if wanted(self._link.last.time_s):
            tracker.until = tracker.blocks if self._target is None else self._target
            await self._link.tell(ScriptInputs(tracker.token, tracker.until))

    async def _stop(self) -> None:
        """Stop a program of the driver by its command, any other by the dashboard."""
        link, tracker, stop_s = self._link, self._tracker, self._times.stop_s
        if tracker is not None and self._hears(link.last):
            await link.tell(ScriptInputs(tracker.token, 0, ScriptCommand.STOP))
            await link.until(lambda: link.stands, SOFT_SHARE * stop_s)
        if link.last.runtime != UrRuntimeState.STOPPED:
            await stop(self._addresses.dashboard, stop_s)
        await link.standstill("stop", stop_s)

    async def _stop_anew(self) -> None:
        """Stop by the dashboard, which does not report motion: RTDE shows it. LinkError if it cannot be opened."""
        await stop(self._addresses.dashboard, self._times.stop_s)
        # without inputs: the controller may still reserve those of the lost link
        link = self._make_connection(_ignore, has_inputs=False)
        try:
            await link.open()
            await link.standstill("stop", self._times.stop_s)
        except (LinkError, ProtocolError, DeviceRefused) as error:
            raise LinkError(
                f"{self._name}: the dashboard reports that no program runs, but RTDE does not show that the robot "
                f"stands: {error}. See that it stands, then check the link."
            ) from error
        finally:
            await link.close()

    async def _seen(self, sample: RtdeSample) -> None:
        """Record the controller's state; a program that has ended gets no more heartbeats."""
        tracker = self._tracker
        if tracker is None:
            return
        tracker.update(sample)
        if tracker.heard and not (sample.token == tracker.token and sample.phase in (*LIVE, ScriptPhase.ENDS)):
            self._link.orders = None

    def _hears(self, sample: RtdeSample) -> bool:
        """Whether the program of the driver accepts commands."""
        ours = self._tracker is not None and sample.token == self._tracker.token and sample.phase in LIVE
        return ours and sample.runtime == UrRuntimeState.PLAYING

    def _obstacle(self) -> str:
        sample, tracker = self._link.last, self._tracker
        if why := sample.obstacle():
            return why
        if tracker is not None and tracker.live and sample.runtime in (UrRuntimeState.PAUSING, UrRuntimeState.PAUSED):
            return "the program is paused at the controller (continue it there, or prepare it again)"
        return ""

    async def _not_remote(self) -> str:
        remote = await in_remote_control(self._addresses.dashboard)
        return "" if remote else "it is in local control (switch it to remote control at the pendant)"

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


async def _ignore(_sample: RtdeSample) -> None:
    """Receive a sample that only ``standstill`` uses."""


# The device type ``universal_robots``: a robot on a Universal Robots controller (docs/how-to/universal-robots.md).

WAY_S = 0.02
"""Longest transmission time of a sample."""
Port = Annotated[int, Field(ge=1, le=65535)]


class UniversalRobotsOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "universal_robots"``."""

    address: str
    """RTDE address of the controller: ``tcp://host:30004``."""
    dashboard_port: Port = 29999
    """TCP port of its dashboard server. [1]"""
    primary_port: Port = 30001
    """TCP port of its primary client interface, which accepts scripts. [1]"""
    rate_hz: Annotated[float, Field(ge=10.0, le=500.0)] = 125.0
    """Rate of the controller's samples: a block's end is known to one period. e-Series: up to 500. [Hz]"""
    first_register: Annotated[int, Field(ge=0, le=43)] = 24
    """First of polishd's integer registers in the controller: five inputs and four outputs. [1]"""
    tool_z: Literal["into_part", "out_of_part"] = "into_part"
    """Direction of the tool frame's z, as in the program's dialect; a lift goes the opposite way."""
    watchdog_s: Annotated[float, Field(gt=0.0, le=600.0)] = 8.0
    """The controller's watchdog: after this time without a message from polishd it stops the program."""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = 1.0
    """Longest time without a sample; then the link is lost and contact is left."""
    stop_s: Annotated[float, Field(gt=0.0, le=60.0)] = 5.0
    """Longest time to stop, or to lift the tool off."""


def _build(options: UniversalRobotsOptions, context: DeviceContext) -> UniversalRobot:
    address = tcp_address(options.address, context.base_dir, "universal_robots")
    report_s = 2.0 / options.rate_hz + WAY_S
    times = RobotTimes(options.silence_s, options.watchdog_s, options.stop_s, report_s=report_s)
    addresses = Addresses.of(address.host, address.port, options.dashboard_port, options.primary_port)
    settings = Settings(UrRegisters(options.first_register), options.watchdog_s, options.tool_z == "into_part")
    return UniversalRobot(addresses, settings, times, options.rate_hz)


def _takes(blocks: Sequence[bytes]) -> str:
    """Return why the controller cannot run the blocks: it runs only URScript."""
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
