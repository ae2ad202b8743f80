"""Rigs: a device under test, faults of its link, and the scope of its tests."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen, TimeoutExpired
from typing import Any, Generic, TypeVar

import pytest
import pytest_asyncio

from polishd.api import DeviceContext, DeviceError, DeviceFault, DeviceType, LinkError, PluginError
from polishd.daemon.contact.safety import run_to_completion
from polishd.interfaces import Device
from polishd.plugin_loader import misspelt_hooks, wrong_version
from polishd.testing.helpers import SOON_S

D = TypeVar("D")
ROOM_S = 1.5
"""Added to the device's silence time, for delays of the computer."""
ANSWERS = 8
"""Longest call to a dead device: four answers, each of which may arrive late by as much again."""


def _line(number: int) -> bytes:
    return b"G1 X%d F60" % number


@dataclass(frozen=True, slots=True, kw_only=True)
class TestScope:
    """Values that a suite may use on a device."""

    force_n: float = 12.0
    """Actuator: largest force of the tests."""
    most_n: float | None = 50.0
    """Actuator: a larger force must be refused; None: not tested."""
    band: float = 0.05
    """Actuator: tolerance of a regulated force, share."""
    touch_mm: float | None = None
    """Actuator: position of the tool in contact, if known."""
    period_s: float | None = 0.05
    """Actuator: period of samples; None: often enough for its watchdog."""
    rpm: float = 1000.0
    """Spindle: speed of the tests; also half of it, and backward."""
    most_rpm: float | None = 6000.0
    """Spindle: highest allowed speed, a higher one must be refused; None: only up to ``rpm`` is tested."""
    forgives: bool = True
    """Spindle: ``make_safe`` clears the fault of its watchdog; otherwise the operator resets it."""
    block: Callable[[int], bytes] | None = _line
    """Robot: returns block n of up to 200, each of some tens of ms. None: no program is run."""
    bad_block: bytes = b"?what"
    """Robot: a block that it cannot read."""
    parts: tuple[str, str] = ("P-1", "lens 7")
    """Loader: its parts; the seat is empty at first."""
    no_part: str = "P-2"
    """Loader: a part that it does not have."""


USUAL = TestScope()


@dataclass
class Rig(Generic[D]):
    """A device and actions on its link. An action that is None is not possible: tests that need it are skipped."""

    device: D
    cut: Callable[[], None] | None = None
    """Cut the link permanently."""
    mute: Callable[[], None] | None = None
    """Mute the peer, which keeps running: a half-open link."""
    safe: Callable[[], bool] | None = None
    """Whether the machine, independent of the driver, exerts no force and stands still."""
    whole_file: bool = False
    """Robot that accepts its program in one piece: ``send`` does not wait for credit."""
    scope: TestScope = USUAL
    soon_s: float = SOON_S
    """Longest duration of a test step; a longer one hangs."""

    def unplug(self) -> None:
        """Cut the link, in a test that is marked with it."""
        if self.cut is not None:
            self.cut()

    def silence(self) -> None:
        """Mute the peer, in a test that is marked with it."""
        if self.mute is not None:
            self.mute()

    @property
    def prompt_s(self) -> float:
        """Longest time to detect a dead link."""
        return self._silence_s + ROOM_S

    @property
    def bound_s(self) -> float:
        """Longest time of a call to a dead device."""
        return ANSWERS * self._silence_s

    async def rests(self) -> bool:
        """Whether it exerts no force and stands still, by the machine's report, or by the device's."""
        if self.safe is not None:
            return self.safe()
        device: Any = self.device
        try:
            return bool((await device.status()).safe)
        except LinkError:  # it is closed: open it for the status, as probe does
            await device.open()
            try:
                return bool((await device.status()).safe)
            finally:
                await device.close()

    @property
    def _silence_s(self) -> float:
        times = getattr(self.device, "times", None)
        return 1.0 if times is None else float(times.silence_s)


MakeRig = Callable[[Path], AbstractAsyncContextManager[Rig[Any]]]
"""(folder of the test) -> the rig, with its peer running and its device not yet open; ends both."""

NEEDS = {"cut": "polishd_cuts", "mute": "polishd_mutes"}
"""Action of a rig, by the mark of the tests that use it."""


def rig_fixture(name: str) -> Any:
    """Return the fixture of that name: the rig of each of the module's ``CASES``, or of each device of ``--cell``."""

    async def fixture(request: pytest.FixtureRequest, rig_folder: Path) -> AsyncIterator[Rig[Any]]:
        make: MakeRig = request.param
        async with make(rig_folder) as rig:
            for ability, mark in NEEDS.items():
                if getattr(rig, ability) is None and request.node.get_closest_marker(mark):
                    pytest.skip(f"the rig cannot {ability} the link")
            yield rig

    return pytest_asyncio.fixture(fixture, name=name)


cuts = pytest.mark.polishd_cuts
mutes = pytest.mark.polishd_mutes
moves = pytest.mark.polishd_moves
"""Test with motion, possible motion, or a loaded program; without pressing."""
fresh = pytest.mark.polishd_fresh
"""Test that needs a device that was just powered up: any other could continue its last program."""
presses = pytest.mark.polishd_presses
"""Test that puts the tool on the part."""


# A simulator as a process: ending it is a power cut, stopping it a half-open link.

START_S = 60.0
END_S = 5.0


@dataclass
class ReplayPeer:
    """A running simulator process."""

    process: Popen[bytes]
    output: int
    """File descriptor of its standard output."""
    reported: dict[str, Any] = field(default_factory=dict)
    """Last value of each key that the simulator reported."""
    _rest: bytes = b""

    @property
    def endpoint(self) -> str:
        """Address of the simulator."""
        return str(self.reported["endpoint"])

    @property
    def reports_safe(self) -> bool:
        """Whether the simulator reports if it is safe."""
        return "safe" in self.reported

    def safe(self) -> bool:
        """Whether it reports that it exerts no force and stands still."""
        self.hear()
        return bool(self.reported["safe"])

    def cut(self) -> None:
        """Cut its power."""
        self.process.kill()

    def mute(self) -> None:
        """Stop the process: it stays alive and sends nothing more."""
        self.process.send_signal(signal.SIGSTOP)

    def hear(self) -> bool:
        """Process its output; return False once it has ended."""
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self.output, 4096):
                *lines, self._rest = (self._rest + data).split(b"\n")
                for line in lines:
                    self.reported |= _message(line)
            return False
        return True


@asynccontextmanager
async def started(command: Sequence[str]) -> AsyncIterator[ReplayPeer]:
    """Run the simulator of that command line during the block; DeviceFault if it does not start."""
    with Popen(list(command), stdout=PIPE, stdin=DEVNULL) as process:  # noqa: ASYNC220 -- it is not waited for
        peer = ReplayPeer(process, process.stdout.fileno() if process.stdout else -1)
        os.set_blocking(peer.output, False)
        try:
            await _until_up(peer, " ".join(command))
            yield peer
        finally:
            await asyncio.to_thread(_end, process)


async def _until_up(peer: ReplayPeer, command: str) -> None:
    up = asyncio.Event()

    def hear() -> None:
        if not peer.hear() or "endpoint" in peer.reported:
            up.set()

    loop = asyncio.get_running_loop()
    loop.add_reader(peer.output, hear)
    try:
        async with asyncio.timeout(START_S):
            await up.wait()
    except TimeoutError:
        peer.hear()
    finally:
        loop.remove_reader(peer.output)
    if "endpoint" not in peer.reported:
        how = f"printed no address within {START_S:g} s" if peer.hear() else "ended before it printed its address"
        raise DeviceFault(f'the simulator {command} {how}. Print the line {{"endpoint": "..."}} at its start.')


def _message(line: bytes) -> dict[str, Any]:
    """Parse a line of JSON; an empty result for other lines, which simulators may also print."""
    try:
        message = json.loads(line)
    except ValueError:
        return {}
    return message if isinstance(message, dict) else {}


def _end(process: Popen[bytes]) -> None:
    process.send_signal(signal.SIGCONT)
    process.terminate()
    try:
        process.wait(END_S)
    except TimeoutExpired:
        process.kill()


async def close_safe(device: Device) -> None:
    """Make the device safe and close it; an interrupt or an error meanwhile does not leave the tool on the part."""

    async def both() -> None:
        try:
            await device.make_safe()
        finally:
            await device.close()

    await run_to_completion(both())


# A driver case for the suites: construction, address, and scope of the tests.

ENDPOINT = "{endpoint}"


@dataclass(frozen=True, kw_only=True)
class DriverCase:
    """An entry of a test module's ``CASES``: a simulator, whose link can be cut and muted, or a real device."""

    plugin: Any
    """Plugin: a module or an object with ``polishd_device_types``."""
    type: str
    """Name of the device type."""
    options: Mapping[str, Any]
    """Keys of its section besides ``type``; ``"{endpoint}"`` in a text is the simulator's address."""
    simulator: Sequence[str] = ()
    """Command line of the simulator (polishd.testing.device_rig); empty: the options name a real device."""
    scope: TestScope = USUAL
    whole_file: bool = False
    """Robot that accepts its program in one piece: ``send`` does not wait for credit."""
    soon_s: float = 60.0
    """Longest duration of a test step; a longer one hangs."""

    @property
    def __name__(self) -> str:
        """Name of the case in test names."""
        return self.type

    @asynccontextmanager
    async def __call__(self, folder: Path) -> AsyncIterator[Rig[Device]]:
        """Yield the rig of one test."""
        if not self.simulator:
            device = self.build(folder, "")
            try:
                yield Rig(device, whole_file=self.whole_file, scope=self.scope, soon_s=self.soon_s)
            finally:
                await close_safe(device)
            return
        async with started(self.simulator) as peer:
            device = self.build(folder, peer.endpoint)
            safe = peer.safe if peer.reports_safe else None
            try:
                yield Rig(device, peer.cut, peer.mute, safe, self.whole_file, self.scope, self.soon_s)
            finally:
                with contextlib.suppress(DeviceError):
                    await device.close()

    def build(self, folder: Path, endpoint: str) -> Device:
        """Build the closed device; PluginError or pydantic's ValidationError for a wrong plugin or wrong options."""
        given = {
            key: value.replace(ENDPOINT, endpoint) if isinstance(value, str) else value
            for key, value in self.options.items()
        }
        kind = self._kind()
        device: Device = kind.build(kind.options.model_validate(given), DeviceContext(folder, folder, "P-1", ()))
        return device

    def _kind(self) -> DeviceType:
        for wrong in (wrong_version(self.plugin), misspelt_hooks(self.plugin)):
            if wrong:
                raise PluginError(f"{self.plugin!r}: {wrong}")
        kinds = {kind.name: kind for kind in self.plugin.polishd_device_types()}
        if self.type not in kinds:
            raise PluginError(f"{self.plugin!r} has no device type {self.type!r}; it has {', '.join(kinds)}")
        kind: DeviceType = kinds[self.type]
        return kind
