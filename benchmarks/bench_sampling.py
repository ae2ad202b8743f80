"""Lateness of the answers of four devices sampled at 100 Hz each, beside a running solve and without one.

Real drivers on one loop, as in the daemon; the devices are simulated, in separate processes. Robot and spindle send
their state unprompted, actuator and force sensor are polled. Measured is the time from the due time of a sample to its
arrival, the wait for the loop included. The solve runs in a separate process, as in the daemon, with its nice value.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, contextmanager
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np

from benchmarks.dwell_cases import Case, build
from benchmarks.harness import Progress, Row, running_cell
from polishd.config.device_profile_checks import profile_of
from polishd.drivers.cia402.device_types import SIMULATED_EDS
from polishd.drivers.cia402.drive import CanNodeAddress
from polishd.drivers.cia402.protocol import read_dictionary
from polishd.drivers.cia402.spindle import Cia402Spindle, SpindleScale
from polishd.drivers.profile_device import build as make
from polishd.drivers.robot_link.driver import RobotLink
from polishd.drivers.transport.address import SocketcandAddress, Tcp, parse_address
from polishd.model.devices import SpindleTimes
from polishd.process.dwell import newton_cg

RATE_HZ = 100.0
SPELL_S = 10.0
"""Of each turn; turns with and without a solve alternate, so that a busy spell of the machine hits both."""
TURNS = 3
NICE = 5
"""Of the process that computes: docs/how-to/host.md."""
MEANT_MS = 20.0
"""Aim for p99.9 on an idle machine: printed beside the figure, since the load of this machine is not known."""
SIM = """
[plant]
aperture_mm = 40.0
[robot]
port = 0
[actuator]
kind = "modbus_tcp"
[spindle]
kind = "socketcand"
[force_sensor]
"""

Ask = Callable[[], Awaitable[object]]


def rows(progress: Progress) -> Iterator[Row]:
    """Milliseconds late, p99 and p99.9: beside a solve, and without."""
    with running_cell(SIM) as endpoints:
        late_ms = asyncio.run(measured(endpoints, progress))
    for share in (99.0, 99.9):
        beside, alone = (float(np.percentile(late_ms[solves], share)) for solves in (True, False))
        meant = f", meant to be at most {MEANT_MS:g} ms where nothing else runs" if share > 99.0 else ""
        name = f"four devices at {RATE_HZ:g} Hz beside a solve, p{share:g} of lateness{meant}"
        yield Row(name, beside, {"the same without a solve": alone}, "ms")


async def measured(endpoints: dict[str, str], progress: Progress) -> dict[bool, list[float]]:
    """Lateness of all samples, ms: with a solve, and without."""
    taken: dict[bool, list[float]] = {True: [], False: []}
    async with AsyncExitStack() as opened:
        asks = await devices(endpoints, opened)
        for turn in range(1, TURNS + 1):
            for solves, late_ms in taken.items():
                progress(f"sampling {'beside a solve' if solves else 'alone'} {turn}/{TURNS}")
                with solving() if solves else idle():
                    async with asyncio.TaskGroup() as group:
                        for ask in asks:
                            group.create_task(sampled(ask, late_ms))
    return taken


async def devices(endpoints: dict[str, str], opened: AsyncExitStack) -> list[Ask]:
    """Open the four devices; return a sampler of each."""
    names = ("robot", "actuator", "force_sensor", "spindle")
    robot_at, actuator_at, sensor_at, spindle_at = (parse_address(endpoints[name], Path()) for name in names)
    if not (isinstance(robot_at, Tcp) and isinstance(actuator_at, Tcp) and isinstance(sensor_at, Tcp)):
        raise TypeError(f"the simulated devices are not where they were to be: {endpoints}")
    if not isinstance(spindle_at, SocketcandAddress):
        raise TypeError(f"the simulated spindle is not on CAN: {endpoints}")
    robot = RobotLink(robot_at, client="benchmark")
    actuator = make.actuator(profile_of("voice_coil_modbus", Path()), actuator_at)
    place = CanNodeAddress(spindle_at, 5, 0x45, SpindleTimes().silence_s, SpindleTimes().watchdog_s)
    spindle = Cia402Spindle(place, read_dictionary(SIMULATED_EDS, 5), SpindleScale(rpm_per_unit=0.1), SpindleTimes())
    sensor = make.force_sensor(profile_of("force_sensor_line", Path()), sensor_at)
    for one in (robot, actuator, spindle, sensor):
        await one.open()
        opened.push_async_callback(one.close)
    return [robot.progress, actuator.status, spindle.status, sensor.status]


async def sampled(ask: Ask, late_ms: list[float]) -> None:
    """One device, for a spell."""
    begin = time.perf_counter()
    for number in range(round(SPELL_S * RATE_HZ)):
        due = begin + number / RATE_HZ
        await asyncio.sleep(max(due - time.perf_counter(), 0.0))
        await ask()
        late_ms.append(1e3 * (time.perf_counter() - due))


@contextmanager
def solving() -> Iterator[None]:
    """Run a process that solves, one part after the other; the first solve has begun when the block starts."""
    context = multiprocessing.get_context("fork")
    began = context.Event()
    process: BaseProcess = context.Process(target=_solve, args=(began,))
    process.start()
    try:
        if not began.wait(60.0):
            raise RuntimeError("the solve did not begin within 60 s")
        yield
        if not process.is_alive():
            raise RuntimeError(f"the solve ended with exit code {process.exitcode}")
    finally:
        process.kill()
        process.join()


@contextmanager
def idle() -> Iterator[None]:
    """No load."""
    yield


def _solve(began: Event) -> None:
    os.nice(NICE)
    problem = build(Case(100.0, 5.0, 1e-4))
    began.set()
    while True:
        newton_cg.solve(problem, 600.0, 1e-8)
