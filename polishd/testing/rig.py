"""A device under test, what may happen to it, and what may be asked of it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import pytest
import pytest_asyncio

from polishd.api import LinkError
from polishd.testing.patience import SOON_S

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
