"""A device under test, what may happen to it, and what may be asked of it."""

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
from polishd.interfaces import Device
from polishd.plugin_loader import misspelt_hooks, wrong_version
from polishd.testing.helpers import SOON_S

D = TypeVar("D")
ROOM_S = 1.5
"""Beyond its own silence, for what else a machine does."""
ANSWERS = 8
"""No call to a dead device takes longer: four answers, each of which may still come as late again."""


def _line(number: int) -> bytes:
    return b"G1 X%d F60" % number


@dataclass(frozen=True, slots=True, kw_only=True)
class TestScope:
    """What a suite may ask of a device."""

    force_n: float = 12.0
    """Actuator: pressed with, and with less."""
    most_n: float | None = 50.0
    """Actuator: more must be refused; None: more is not asked for."""
    band: float = 0.05
    """Actuator: share by which a regulated force may be off."""
    touch_mm: float | None = None
    """Actuator: how far out the tool is in contact, where that is known."""
    period_s: float | None = 0.05
    """Actuator: between samples; None: only often enough for its watchdog."""
    rpm: float = 1000.0
    """Spindle: turned with, half as fast, and backwards."""
    most_rpm: float | None = 6000.0
    """Spindle: may be asked for; more must be refused; None: more than ``rpm`` is not asked for."""
    forgives: bool = True
    """Spindle: the fault of its own watchdog is taken back when it is made safe; else a person resets it."""
    block: Callable[[int], bytes] | None = _line
    """Robot: the block of that number, of up to 200; each takes some tens of ms. None: nothing is run."""
    bad_block: bytes = b"?what"
    """Robot: what it cannot read."""
    parts: tuple[str, str] = ("P-1", "lens 7")
    """Loader: parts that it has; the seat is empty at first."""
    no_part: str = "P-2"
    """Loader: one that it has not."""


USUAL = TestScope()


@dataclass
class Rig(Generic[D]):
    """A device, and what may happen to it. What is None cannot be done to it: tests that need it are skipped."""

    device: D
    cut: Callable[[], None] | None = None
    """Pull the plug for good."""
    mute: Callable[[], None] | None = None
    """The peer goes on living and says nothing more: a half-open link."""
    safe: Callable[[], bool] | None = None
    """The machine itself, not the driver: it exerts nothing and stands still."""
    whole_file: bool = False
    """A robot that takes its program in one piece: nobody waits for credit."""
    scope: TestScope = USUAL
    soon_s: float = SOON_S
    """What takes longer hangs."""

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
        """So soon a dead link is known."""
        return self._silence_s + ROOM_S

    @property
    def bound_s(self) -> float:
        """No call to a dead device takes longer."""
        return ANSWERS * self._silence_s

    async def rests(self) -> bool:
        """It exerts nothing and stands still: by the machine's own word, or else by the device's."""
        if self.safe is not None:
            return self.safe()
        device: Any = self.device
        try:
            return bool((await device.status()).safe)
        except LinkError:  # it is closed: asked as probe asks
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
"""(folder of the test's own) -> the rig, its peer running and its device not yet open; ends both."""

NEEDS = {"cut": "polishd_cuts", "mute": "polishd_mutes"}
"""Of a rig, by the mark of the tests that do it."""


def rig_fixture(name: str) -> Any:
    """The fixture of that name: the rig of each of the module's ``CASES``, or of each device of ``--cell``."""

    async def fixture(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[Rig[Any]]:
        make: MakeRig = request.param
        async with make(tmp_path) as rig:
            for ability, mark in NEEDS.items():
                if getattr(rig, ability) is None and request.node.get_closest_marker(mark):
                    pytest.skip(f"nothing here can {ability} its link")
            yield rig

    return pytest_asyncio.fixture(fixture, name=name)


cuts = pytest.mark.polishd_cuts
mutes = pytest.mark.polishd_mutes
moves = pytest.mark.polishd_moves
"""Something moves or could, or a program is loaded; nothing is pressed."""
fresh = pytest.mark.polishd_fresh
"""Only with a device that was just powered up: any other could go on with what it had."""
presses = pytest.mark.polishd_presses
"""The tool is put on the part."""


# A simulator as a process: its end is a power cut, stopping it a half-open link.

START_S = 60.0
END_S = 5.0


@dataclass
class ReplayPeer:
    """A running simulator."""

    process: Popen[bytes]
    output: int
    """Descriptor of its standard output."""
    told: dict[str, Any] = field(default_factory=dict)
    """The last word on each thing."""
    _rest: bytes = b""

    @property
    def endpoint(self) -> str:
        """Where it answers."""
        return str(self.told["endpoint"])

    @property
    def tells_safe(self) -> bool:
        """It says whether it exerts or moves anything."""
        return "safe" in self.told

    def safe(self) -> bool:
        """It exerts nothing and stands still, by its own word."""
        self.hear()
        return bool(self.told["safe"])

    def cut(self) -> None:
        """Cut its power."""
        self.process.kill()

    def mute(self) -> None:
        """It lives and says nothing more."""
        self.process.send_signal(signal.SIGSTOP)

    def hear(self) -> bool:
        """Take what it has written; False once it has ended, and nothing more will come."""
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self.output, 4096):
                *lines, self._rest = (self._rest + data).split(b"\n")
                for line in lines:
                    self.told |= _message(line)
            return False
        return True


@asynccontextmanager
async def started(command: Sequence[str]) -> AsyncIterator[ReplayPeer]:
    """The simulator of that command line, for the time of the block; DeviceFault where it does not come up."""
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
        if not peer.hear() or "endpoint" in peer.told:
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
    if "endpoint" not in peer.told:
        how = f"did not say within {START_S:g} s" if peer.hear() else "ended before it said"
        raise DeviceFault(f'the simulator {how} where it answers: {{"endpoint": "..."}} on a line; it is {command}')


def _message(line: bytes) -> dict[str, Any]:
    """What a line tells; nothing where it is another's: simulators may say what they like beside."""
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


# A driver of one's own for the suites: how it is built, where its device is, and what may be asked of it.

ENDPOINT = "{endpoint}"


@dataclass(frozen=True, kw_only=True)
class DriverCase:
    """An entry of a test module's ``CASES``: a simulator, whose link can be cut and muted, or a real device."""

    plugin: Any
    """The plugin: a module, or an object, with ``polishd_device_types``."""
    type: str
    """The name of the device type."""
    options: Mapping[str, Any]
    """The keys of its section besides ``type``; ``"{endpoint}"`` in a text is where the simulator answers."""
    simulator: Sequence[str] = ()
    """Command line of the simulator (polishd.testing.device_rig); none: the options name a real device."""
    scope: TestScope = USUAL
    whole_file: bool = False
    """Of a robot: it takes its program in one piece, so that nobody waits for credit."""
    soon_s: float = 60.0
    """What takes longer hangs."""

    @property
    def __name__(self) -> str:
        """In the names of tests."""
        return self.type

    @asynccontextmanager
    async def __call__(self, folder: Path) -> AsyncIterator[Rig[Device]]:
        """The rig of one test."""
        if not self.simulator:
            device = self.build(folder, "")
            try:
                yield Rig(device, whole_file=self.whole_file, scope=self.scope, soon_s=self.soon_s)
            finally:
                await device.make_safe()
                await device.close()
            return
        async with started(self.simulator) as peer:
            device = self.build(folder, peer.endpoint)
            safe = peer.safe if peer.tells_safe else None
            try:
                yield Rig(device, peer.cut, peer.mute, safe, self.whole_file, self.scope, self.soon_s)
            finally:
                with contextlib.suppress(DeviceError):
                    await device.close()

    def build(self, folder: Path, endpoint: str) -> Device:
        """The device, not open; PluginError or pydantic's ValidationError where plugin or options are wrong."""
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
