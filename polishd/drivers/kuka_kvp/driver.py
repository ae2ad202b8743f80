"""Driver of a KUKA controller: the module by a share, commands by C3 Bridge, progress by variables."""

from __future__ import annotations

import contextlib
import secrets
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Annotated

from pydantic import Field

from polishd.api import (
    ConfigError,
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
from polishd.drivers.kuka_kvp.program import (
    KEPT,
    LONGEST_LINE,
    NAME,
    READ_NAMES,
    STOPPED,
    KrlPhase,
    KrlProgram,
    KrlProgramTracker,
    KukaSample,
    begin_names,
    krl_lines,
    read_number,
    require_declared,
)
from polishd.drivers.kuka_kvp.protocol import KvpLink, ProgramOrder
from polishd.drivers.transport.address import Tcp, tcp_address
from polishd.drivers.transport.background import PeriodicTimer
from polishd.drivers.transport.file_delivery import Delivery, Folder
from polishd.drivers.transport.program_robot import IsWanted, ProgramRobot
from polishd.drivers.transport.program_tracker import STANDS, PollingConnection, comes_to_rest
from polishd.util.files import named_path

# The polled connection: samples in, heartbeats out.

OPEN_S = 3.0
BEAT_S = 0.1
BEATS = 1 << 15
TIMER_S = 9e5
"""Above this time the watchdog's timer may start again: it does after 1e6 s, so that its 32 bits are never full."""


class KvpConnection(PollingConnection[KvpLink, KukaSample]):
    """Connection that polls the controller and writes the heartbeat between two readings."""

    def __init__(
        self, address: Tcp, poll_s: float, silence_s: float, on_sample: Callable[[KukaSample], Awaitable[None]]
    ) -> None:
        super().__init__(str(address), OPEN_S, on_sample)
        self.address = address
        self.beats = False
        """The program of polishd gets heartbeats; without them the watchdog stops it."""
        self._poll_s, self._silence_s = poll_s, silence_s
        self._beat = secrets.randbelow(BEATS)
        self.ticks = False
        """The watchdog's clock has advanced since the connection was opened."""
        self.cycles = 0
        """Cycles of the watchdog that were seen, by its clock."""
        self._changed_s = self._beaten_s = 0.0
        self._block = self._token = 0
        """Of the last sample, of this connection or an earlier one."""

    async def _connect(self) -> KvpLink:
        link = await KvpLink.connect(self.address, self._silence_s)
        try:
            if not await link.text("@PROXY_PORT"):
                raise DeviceRefused(
                    f"{self.name}: KUKAVARPROXY starts and stops no program. Install C3 Bridge 1.2 or later."
                )
        except BaseException:
            await link.close()
            raise
        self.ticks, self._changed_s = False, time.monotonic()
        return link

    async def _disconnect(self, link: KvpLink) -> None:
        await link.close()

    def _stands(self, recent: Sequence[KukaSample]) -> bool:
        return not any(sample.plays for sample in recent)

    async def _snapshots(self, link: KvpLink) -> AsyncIterator[KukaSample]:
        timer = PeriodicTimer(self._poll_s)
        while True:
            sample = KukaSample.of(await link.read(READ_NAMES))
            self._require_clock(sample)
            begins = await self._begins(link, sample)
            watched = time.monotonic() - self._changed_s < self._silence_s
            yield replace(sample, is_watched=watched, begins=begins)
            if self.beats and time.monotonic() - self._beaten_s > BEAT_S:
                self._beaten_s, self._beat = time.monotonic(), (self._beat + 1) % BEATS
                await link.write("POLISHD_BEAT", str(self._beat))
            await timer.next()

    async def _begins(self, link: KvpLink, sample: KukaSample) -> tuple[tuple[int, float], ...]:
        """Read the begins of the blocks since the last sample. The watchdog keeps the newest ones."""
        first = self._block + 1 if sample.token == self._token else sample.block
        blocks = range(max(first, sample.block - KEPT + 1), sample.block + 1 if sample.token else 0)
        names = begin_names(blocks)
        values = await link.read(names) if names else {}
        self._block, self._token = sample.block, sample.token
        return tuple((block, read_number(values, name) / 1e3) for block, name in zip(blocks, names, strict=True))

    def _require_clock(self, sample: KukaSample) -> None:
        last = self._recent[-1] if self._recent else sample
        if sample.session != last.session or sample.time_s < last.time_s < TIMER_S:
            raise LinkError(f"{self.name}: the controller or its watchdog has restarted")
        if last.time_s != sample.time_s:
            self.ticks, self._changed_s = True, time.monotonic()
            self.cycles += 1


# The robot.

LOOK_S = 0.02
"""Pause between two readings over a new link."""
ANSWER_S = 2.0
"""Longest wait for the answer to a command."""
CYCLE_S = 0.02
"""Resolution of the begin of a block: cycle of the submit interpreter."""
CYCLES_TO_SETTLE = 3
"""Cycles of the watchdog after standstill: the one under way, a whole one, and one more sample."""


class KukaRobot(ProgramRobot[KrlProgramTracker]):
    """A Robot behind C3 Bridge. A lost link stays lost until ``open``; only ``make_safe`` reconnects.

    It never switches drives on, acknowledges a message or changes mode and override: the operator does that.
    """

    longest_line = LONGEST_LINE

    def __init__(
        self, address: Tcp, delivery: Delivery, controller_dir: str, times: RobotTimes, *, poll_s: float, load_s: float
    ) -> None:
        super().__init__(str(address), times)
        self._delivery = delivery
        self._module = controller_dir + NAME
        self._load_s = load_s
        self._link = KvpConnection(address, poll_s, times.silence_s, self._seen)

    @property
    def _connection(self) -> KvpConnection:
        return self._link

    async def open(self) -> None:
        """See Device. Sends no command. Continues to track a program that ran when the link was lost."""
        await self.close()
        self._stay()
        await self._link.open()

    async def close(self) -> None:
        """See Device."""
        await self._link.close()

    async def identify(self) -> DeviceIdentity:
        """See Device."""
        session = self._link.last.session
        async with self._commands() as link:
            model, serial = await link.text("$TRAFONAME[]"), await link.text("$KR_SERIALNO")
            software = await link.text("$RCV_INFO[]")
        return DeviceIdentity("KUKA", model.lstrip("#") or "KR", serial or "unknown", software, str(session))

    async def status(self) -> DeviceStatus:
        """See Device. Ready: it would run a program as written. Safe: no program runs, and standstill."""
        sample = self._link.last
        why = sample.obstacle()
        return DeviceStatus(not why, self._link.stands, sample.state.removeprefix("#P_").lower(), why)

    async def prepare(self, plan: Plan) -> None:
        """See Robot. Another program that is selected is left as it is."""
        if self._link.last.is_other:
            self._require_able()
        await super().prepare(plan)

    async def hold(self) -> None:
        """See Robot. The robot brakes on its path; ``resume`` continues from there."""
        self._link.check()
        self._stay()
        if self._tracker is not None:
            self._tracker.holds = True
        # At a wait, too: one that is open, or that a command under way opens, lets the robot go on after a standstill.
        if self._link.last.active or self._link.last.plays:
            await self._brake()
        await self._link.standstill("hold", self._times.stop_s)
        # The block at which it stands is reported by the watchdog's next whole cycle, and recorded one sample later.
        cycles = self._link.cycles + CYCLES_TO_SETTLE
        await self._link.until(lambda: self._link.cycles >= cycles, self._times.silence_s)

    async def _clear(self) -> None:
        await self._link.until(lambda: self._link.ticks or not self._link.last.is_watched)
        self._require_able()
        await self._stop()

    def _require_able(self) -> None:
        if why := self._link.last.obstacle():
            raise DeviceRefused(f"{self._name}: {why}. Correct it at the robot, then try again.")

    def _track(self, plan: Plan, blocks: int) -> KrlProgramTracker:
        return KrlProgramTracker(plan, blocks)

    async def _load(self, plan: Plan, tracker: KrlProgramTracker) -> None:
        """Deliver the module and its data list, select and start it, and wait until it waits before its first line."""
        lines, beside = krl_lines(self._lines), plan.program.beside
        require_declared(lines, beside)
        file = KrlProgram(lines, self._stops(plan), secrets.randbelow((1 << 30) - 1) + 1, beside)
        await self._stop()
        # always both: without declarations, too, those of the program before must not stay
        await self._delivery.put(f"{NAME.lower()}.dat", file.data)
        await self._delivery.put(f"{NAME.lower()}.src", file.text)
        async with self._commands() as link:
            limit_ms = round(self._times.watchdog_s * 1e3)
            for name, value in (("GO", 0), ("UNTIL", 0), ("LIMIT", limit_ms), ("BEAT", secrets.randbelow(BEATS))):
                await link.write(f"POLISHD_{name}", str(value))
            answer = await link.control(ProgramOrder.SELECT, self._module, self._load_s)
            if not answer.succeeded:
                raise DeviceRefused(
                    f"{self._name}: the controller does not select {self._module}: {answer.problem}. "
                    "Read its error list at the pendant."
                )
            tracker.sent(file, lines)
            self._link.beats = True
            if not (await link.control(ProgramOrder.START)).succeeded:
                raise DeviceRefused(f"{self._name}: the controller does not start {self._module}. {self._hint()}")
        last = self._link.count + STANDS

        def is_ready() -> bool:
            waits = self._link.last.phase == KrlPhase.WAITS and self._link.last.active
            return tracker.ended or (tracker.live and waits and self._link.count >= last)

        if not await self._link.until(is_ready, self._load_s) or tracker.ended:
            why = tracker.detail or f"it does not wait before its first line within {self._load_s:g} s"
            raise DeviceRefused(f"{self._name}: {self._module} does not run: {why}. {self._hint()}")

    def _hint(self) -> str:
        return self._link.last.obstacle() or "Read the messages at the pendant."

    async def _run(self, tracker: KrlProgramTracker, wanted: IsWanted) -> None:
        """Run to the target: the next wait opens; a stopped program is started."""
        async with self._commands() as link:
            if not wanted(self._link.last.time_s):
                return
            holds = self._holds
            tracker.until = tracker.blocks if self._target is None else self._target
            await link.write("POLISHD_UNTIL", str(tracker.until))
            await link.write("POLISHD_GO", str(tracker.token))
            if self._link.last.state != STOPPED or holds != self._holds:
                return
            if not (await link.control(ProgramOrder.START)).succeeded:
                raise DeviceFault(f"{self._name}: the controller does not continue. {self._hint()}")
            if holds != self._holds:  # held meanwhile, and its stop may have come before this start
                await link.control(ProgramOrder.STOP)

    async def _stop(self) -> None:
        """Stop any program, see that the robot stands, and deselect it."""
        if self._tracker is not None:
            self._tracker.forget()
        if self._link.last.active or self._link.last.plays:
            await self._brake()
        await self._link.standstill("stop", self._times.stop_s)
        async with self._commands() as link:
            await self._deselect(link)

    async def _stop_anew(self) -> None:
        link = await KvpLink.connect(self._link.address, ANSWER_S)
        try:
            await link.control(ProgramOrder.STOP)

            async def read() -> KukaSample:
                return KukaSample.of(await link.read(READ_NAMES))

            def moves(_before: KukaSample, last: KukaSample) -> bool:
                return last.active or not last.robot_stopped

            if not await comes_to_rest(read, moves, LOOK_S, self._times.stop_s):
                raise DeviceFault(f"{self._name}: still moving {self._times.stop_s:g} s after stop")
            await self._deselect(link)
        finally:
            await link.close()

    async def _brake(self) -> None:
        async with self._commands() as link:
            await link.control(ProgramOrder.STOP)  # refused if no program runs: the state decides

    async def _deselect(self, link: KvpLink) -> None:
        await link.control(ProgramOrder.CANCEL)  # refused if none is selected
        for name in ("TOKEN", "PHASE"):
            await link.write(f"POLISHD_{name}", "0")

    @asynccontextmanager
    async def _commands(self) -> AsyncIterator[KvpLink]:
        """A connection for commands: a selection takes seconds, and the polled one must not wait for it."""
        self._link.check()
        link = await KvpLink.connect(self._link.address, ANSWER_S)
        try:
            yield link
        finally:
            await link.close()

    async def _seen(self, sample: KukaSample) -> None:
        """Record the controller's state; continue from a stop that is not wanted."""
        tracker = self._tracker
        if tracker is None:
            return
        tracker.update(sample)
        is_over = sample.token == tracker.token and sample.phase == KrlPhase.DONE
        self._link.beats = bool(tracker.token) and not (tracker.dropped or is_over)
        if tracker.held_at is not None:
            await self._pass_stops()

    def _obstacle(self) -> str:
        return self._link.last.obstacle()

    def _override(self) -> float:
        return self._link.last.override

    def _moves(self) -> bool:
        return self._link.last.plays

    def _running(self) -> bool:
        tracker = self._tracker
        return tracker.state == "running" if tracker is not None and tracker.live else self._moves()

    def _drop(self) -> None:
        self._link.beats = False
        super()._drop()


# The device type ``kuka_kvp``: a robot on a KUKA controller (docs/protocols/kuka_kvp.md).


class KukaKvpOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "kuka_kvp"``."""

    address: str
    """Address of C3 Bridge on the controller: ``tcp://host:7000``."""
    delivery: str
    """Folder of the controller's share in which it keeps its modules: ``folder:PATH``."""
    controller_dir: str = "/R1/PROGRAM/"
    """Name of that folder in the controller, with its last ``/``."""
    poll_ms: Annotated[float, Field(ge=2.0, le=500.0)] = 20.0
    """Interval of the readings."""
    watchdog_s: Annotated[float, Field(gt=0.0, le=600.0)] = 8.0
    """The controller's watchdog: after this time without a heartbeat from polishd it stops the program."""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = 1.0
    """Longest time without an answer; then the link is lost and contact is left."""
    stop_s: Annotated[float, Field(gt=0.0, le=60.0)] = 5.0
    """Longest time to stop."""
    load_s: Annotated[float, Field(gt=0.0, le=600.0)] = 30.0
    """Longest time to select the module, and to start it."""


def _build(options: KukaKvpOptions, context: DeviceContext) -> KukaRobot:
    address = tcp_address(options.address, context.base_dir, "kuka_kvp")
    kind, _, path = options.delivery.partition(":")
    if kind != "folder" or not path:
        raise ConfigError(f"delivery {options.delivery!r}: write folder:PATH, with the mounted share of the controller")
    poll_s = options.poll_ms / 1e3
    times = RobotTimes(
        silence_s=options.silence_s,
        watchdog_s=options.watchdog_s,
        stop_s=options.stop_s,
        lifts=False,
        block_end_s=CYCLE_S / 12.0**0.5,
        report_s=STANDS * poll_s + CYCLE_S,
    )
    folder = Folder(named_path(context.base_dir, path).absolute())
    return KukaRobot(address, folder, options.controller_dir, times, poll_s=poll_s, load_s=options.load_s)


def _takes(blocks: Sequence[bytes], beside: bytes) -> str:
    """Return why the controller cannot run the blocks with the file beside them."""
    with contextlib.suppress(ProtocolError):
        try:
            require_declared(krl_lines(blocks), beside)
        except DeviceRefused as refusal:
            return str(refusal)
    return ""


DEVICE_TYPES = [
    DeviceType(
        "kuka_kvp",
        "robot",
        KukaKvpOptions,
        _build,
        takes_with_data_file=_takes,
        program_format="krl",
        simulated_by="kuka_kvp",
        simulation_speed=4.0,
        usual_address="tcp://robot-controller:7000",
    )
]
