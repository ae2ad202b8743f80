"""A user's driver under the suites: its errors are reported, and its simulator ends with its test."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import BaseModel, ConfigDict, ValidationError

from polishd.api import DeviceFault, DeviceIdentity, DeviceStatus, DeviceType, LinkError, PluginError, hookimpl
from polishd.testing.device_rig import DriverCase, Rig, started
from polishd.testing.helpers import failure_of, first, seen
from tests.time_limits import SOON_S

TALKS = """
import json, sys, time
print(json.dumps({"endpoint": "tcp://127.0.0.1:9", "safe": True}), flush=True)
print("beside that, no JSON", flush=True)
sys.stdout.write(json.dumps({"safe": False}) + "\\n")
sys.stdout.flush()
time.sleep(1000)
"""


class Options(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)
    address: str


class Box:
    """A device that remembers what was done to it."""

    def __init__(self, options: Options, _context: Any) -> None:
        self.options, self.did, self.is_open = options, list[str](), False

    async def open(self) -> None:
        self.is_open = True

    async def close(self) -> None:
        self.did.append("close")
        self.is_open = False

    async def identify(self) -> DeviceIdentity:
        return DeviceIdentity("Acme", "box", "1", "1")

    async def status(self) -> DeviceStatus:
        if not self.is_open:
            raise LinkError("box: is not open")
        return DeviceStatus(ready=True, safe="make_safe" in self.did, state="idle")

    async def make_safe(self) -> None:
        self.did.append("make_safe")


def plugin(**more: Any) -> Any:
    """One with the device type ``box``, or with what is wrong."""

    @hookimpl
    def polishd_device_types() -> list[DeviceType]:
        return [DeviceType("box", "metrology", Options, Box)]

    return SimpleNamespace(**{"POLISHD_API": 1, "polishd_device_types": polishd_device_types} | more)


def case(**more: Any) -> DriverCase:
    asked = {"plugin": plugin(), "type": "box", "options": {"address": "at {endpoint}"}}
    return DriverCase(**(asked | more))


def simulator(source: str) -> list[str]:
    return [sys.executable, "-c", source]


async def test_a_simulator_is_cut_muted_and_ended(tmp_path: Path) -> None:
    async with case(simulator=simulator(TALKS))(tmp_path) as rig:
        device: Any = rig.device
        assert device.options.address == "at tcp://127.0.0.1:9"
        assert rig.safe is not None
        await seen(lambda: lacks_rest(rig), SOON_S)
        rig.silence()
        rig.unplug()
    assert device.did == ["close"]


async def lacks_rest(rig: Rig[Any]) -> bool:
    return not await rig.rests()


async def test_a_real_device_is_left_safe_and_has_no_link_to_cut(tmp_path: Path) -> None:
    async with case()(tmp_path) as rig:
        device: Any = rig.device
        assert (rig.cut, rig.mute, rig.safe) == (None, None, None)
        assert not await rig.rests()
        assert device.did == ["close"], "it was opened to be asked, and closed again"
    assert device.did == ["close", "make_safe", "close"]


async def test_an_interrupt_or_an_error_while_it_is_made_safe_does_not_leave_it(tmp_path: Path) -> None:
    """Ctrl-C cancels the task; a cancelled make_safe would leave the tool on the part until its watchdog expires."""
    found, begun, lifted = list[Any](), asyncio.Event(), asyncio.Event()

    async def use(make_safe: Callable[[], Awaitable[None]]) -> None:
        async with case()(tmp_path) as rig:
            found.append(rig.device)
            rig.device.make_safe = make_safe  # type: ignore[method-assign, assignment]

    async def lift() -> None:
        begun.set()
        await lifted.wait()
        found[-1].did.append("lifted")

    async def refuse() -> None:
        raise LinkError("box: no answer")

    task = asyncio.create_task(use(lift))
    await begun.wait()
    task.cancel()
    asyncio.get_running_loop().call_soon(lifted.set)
    with pytest.raises(asyncio.CancelledError):
        await task
    assert found[-1].did == ["lifted", "close"]
    with pytest.raises(LinkError, match="no answer"):
        await use(refuse)
    assert found[-1].did == ["close"]


@pytest.mark.parametrize(
    ("source", "said"),
    [("print('ready')", "ended before it printed its address"), ("raise SystemExit(3)", "ended before it printed")],
)
async def test_a_simulator_that_does_not_come_up_is_an_error(source: str, said: str) -> None:
    with pytest.raises(DeviceFault, match=said):
        async with started(simulator(source)):
            pass


@pytest.mark.parametrize(
    ("wrong", "error", "said"),
    [
        ({"plugin": SimpleNamespace()}, PluginError, "POLISHD_API = 1"),
        ({"plugin": plugin(polishd_device_type=simulator)}, PluginError, "is not a hook"),
        ({"type": "bix"}, PluginError, "no device type 'bix'; it has box"),
        ({"options": {"adress": "x"}}, ValidationError, "adress"),
    ],
)
def test_what_is_wrong_with_the_plugin_is_said(tmp_path: Path, wrong: Any, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        case(**wrong).build(tmp_path, "")


async def test_what_does_not_come_is_said_with_the_last_that_came() -> None:
    async def numbers() -> Any:
        for number in range(3):
            yield number

    with pytest.raises(AssertionError, match="the last was 2"):
        await first(numbers(), SOON_S, lambda number: number > 5)

    async def never() -> bool:
        return False

    with pytest.raises(AssertionError, match=r"within 0\.01 s"):
        await seen(never, 0.01)


async def test_a_failure_is_what_a_device_says_and_nothing_else() -> None:
    async def fails(error: Exception) -> None:
        raise error

    assert isinstance(await failure_of(fails(LinkError("gone"))), LinkError)
    with pytest.raises(ValueError, match="a mistake"):
        await failure_of(fails(ValueError("a mistake")))


def test_the_plugin_costs_other_peoples_tests_nothing() -> None:
    code = "import sys, polishd.testing.pytest_plugin; print([n for n in sys.modules if n.startswith('polishd.')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['polishd.testing', 'polishd.testing.pytest_plugin']"


INTERRUPTED = """
import os, signal
from contextlib import asynccontextmanager
from polishd.testing.suites.device import *

@asynccontextmanager
async def case(folder):
    os.kill(os.getpid(), signal.SIGINT)
    await asyncio.Event().wait()
    yield

CASES = [case]
"""


@pytest.mark.full
def test_ctrl_c_while_a_rig_is_built_ends_pytest_as_interrupted(tmp_path: Path) -> None:
    """It ended with a KeyError of pytest's own tmp_path and exit code 1: a device that fails its requirements."""
    (tmp_path / "test_mine.py").write_text(INTERRUPTED)
    (tmp_path / "pytest.ini").write_text("[pytest]\nasyncio_mode = auto\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == pytest.ExitCode.INTERRUPTED, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
