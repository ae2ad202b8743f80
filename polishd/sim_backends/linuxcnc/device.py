"""The process: LinuxCNC in private namespaces, its operator, and reports to the plant."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import socket
import time
from functools import partial
from pathlib import Path

from polishd.config import simulator
from polishd.config.simulator import SimRobotSection
from polishd.model.errors import ConfigError, DeviceFault
from polishd.sim_backends.common import hidden_truth
from polishd.sim_backends.common.faults import SpeedOverride
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import LOOPBACK, SimRuntime
from polishd.sim_backends.linuxcnc import pendant
from polishd.sim_backends.linuxcnc.machine import (
    MOTION,
    MOUNT,
    PENDANT,
    PROGRAMS,
    SHELL_PORT,
    LinuxCncConfig,
    LinuxCncProgram,
    Sampled,
    pose_of,
)

TICK_S = 0.01
TURN_S = 0.05
"""Time between two changes at the pendant: LinuxCNC's task takes each as a command."""
START_S = 25.0
ISOLATE = (
    *("setpriv", "--pdeathsig", "KILL", "unshare", "--map-root-user", "--mount", "--ipc", "--pid", "--fork"),
    *("--kill-child", "--mount-proc", "sh", "-c"),
)
"""A private process namespace: the script ``linuxcnc`` ends other instances by name. All processes end with ours."""
INSIDE = (
    'mount --bind "$1" {mount} && mount -t tmpfs none /tmp && cd {mount} && HOME={mount} '
    "exec unshare --map-user=1000 --map-group=1000 linuxcnc -r {mount}/machine.ini"
)
"""LinuxCNC refuses root, keeps its lock in /tmp, and allows short socket names only."""


class LinuxCncServer:
    """All state of the process."""

    def __init__(self, runtime: SimRuntime) -> None:
        start = runtime.start
        pose = tuple(runtime.link.welcome.get("pose") or start.config.robot.home)
        hidden = hidden_truth.draw(start.config.hidden_truth, start.seed)
        self.folder = start.state / "linuxcnc"
        self.machine = LinuxCncConfig(start.config.robot, pose, hidden.accel_mm_s2)
        self.sampled = Sampled(pose, time.monotonic(), to_pose=partial(pose_of, start.config.robot.rotary_axes_carry))
        self._runtime = runtime
        self._process: asyncio.subprocess.Process | None = None
        self._moved = self._rested = False
        self._override = SpeedOverride()
        self._turned = (1.0, False)
        """Wheel and interlock of the pendant, ..."""
        self._turned_s = 0.0
        """... and the time of their last change."""
        runtime.script.suffer = self._override.suffer

    async def run(self) -> None:
        """Run until it is cancelled."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.machine.write(self.folder)
        os.mkfifo(self.folder / MOTION)
        fifo = os.open(self.folder / MOTION, os.O_RDWR | os.O_NONBLOCK)  # opened for writing too: never at its end
        loop = asyncio.get_running_loop()
        loop.add_reader(fifo, lambda: self.sampled.feed(os.read(fifo, 1 << 16), time.monotonic()))
        try:
            await self._start()
            await switch_on(SHELL_PORT)
            self._runtime.ready(f"tcp://{LOOPBACK}:{self.machine.robot.port}")
            self._runtime.begin_script()
            while True:
                await asyncio.sleep(TICK_S)
                self._turn(time.monotonic())
                self.report()
        finally:
            loop.remove_reader(fifo)
            os.close(fifo)
            if self._process is not None and self._process.returncode is None:
                self._process.kill()

    def report(self) -> None:
        """Report the motion since the last call to the plant."""
        sampled, link = self.sampled, self._runtime.link
        rows = sampled.take_rows()
        if sampled.moving and not self._moved:
            self._see_program()
            link.event("motion_started", sampled.wall_s if not len(rows) else float(rows[0, 1]))
        link.rows(rows, sampled.wall_s, sampled.pose)
        if sampled.rests != self._rested:
            link.event("rest_begun" if sampled.rests else "rest_ended", sampled.wall_s, at_seq=sampled.seq)
        if self._moved and not sampled.moving:
            link.event("motion_stopped", sampled.wall_s)
        self._moved, self._rested = sampled.moving, sampled.rests

    def _turn(self, now_s: float) -> None:
        """Work the pendant as the faults of the script demand."""
        turned = self._override.reported(now_s), self._override.stands
        if turned != self._turned and now_s >= self._turned_s + TURN_S:
            self._turned, self._turned_s = turned, now_s
            self._runtime.link.pace(self._override.actual(now_s), now_s)
            pendant.write(self.folder / PENDANT, turned[0], inhibit=turned[1])

    def _see_program(self) -> None:
        found = sorted((self.folder / PROGRAMS).glob("*.ngc"), key=lambda path: path.stat().st_mtime_ns)
        program = LinuxCncProgram.read(found[-1]) if found else None
        if program is not None and program != self.sampled.program:
            self._runtime.link.event("program_loaded", sha256=program.sha256, blocks=program.blocks)
            self.sampled.seq = -1
        self.sampled.program = program

    async def _start(self) -> None:
        with (self.folder / "linuxcnc.log").open("wb") as log:
            self._process = await asyncio.create_subprocess_exec(
                *ISOLATE,
                INSIDE.format(mount=MOUNT),
                "sh",
                str(self.folder),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )


async def switch_on(port: int) -> None:
    """Act as the operator: out of e-stop, on, homed. DeviceFault where LinuxCNC does not come up."""
    try:
        async with asyncio.timeout(START_S):
            reader, writer = await _connect(port)
            for order in ("hello EMC operator 1.0", "set echo off", "set verbose on", "set enable EMCTOO"):
                writer.write(order.encode() + b"\r\n")
                await reader.readline()
            for order in ("set estop off", "set machine on", "set home -1"):
                writer.write(order.encode() + b"\r\n")
                while b"ACK" not in await reader.readline():
                    pass
            homed = b""
            while homed.count(b"YES") < len("XYZAC"):
                writer.write(b"get joint_homed\r\n")
                while b"JOINT_HOMED" not in (homed := await reader.readline()):
                    pass
                await asyncio.sleep(TICK_S)
            writer.close()
    except TimeoutError:
        raise DeviceFault(f"LinuxCNC was not up, on and homed within {START_S:g} s; see linuxcnc.log") from None


async def _connect(port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    while True:
        with contextlib.suppress(OSError):
            return await asyncio.open_connection(LOOPBACK, port)
        await asyncio.sleep(0.05)


def require_alone(path: Path = Path("/proc/self/ns/net")) -> None:
    """ConfigError where another computer can reach linuxcncrsh, which listens on every interface without protection."""
    others = [name for _, name in socket.if_nameindex() if name != "lo"]
    if others:
        raise ConfigError(
            f"robot.kind = 'linuxcnc' listens on every interface, and this network ({path}) has {', '.join(others)}. "
            "To do: unshare --map-root-user --net sh -c 'ip link set lo up; exec polishd sim SIM.toml'"
        )


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    require_alone()
    if runtime.start.speed != 1.0:
        raise ConfigError("robot.kind = 'linuxcnc' runs in real time. To do: plant.speed = 1, or --speed 1")
    if shutil.which("linuxcnc") is None:
        raise ConfigError("linuxcnc is not installed. To do: apt-get install linuxcnc-uspace")
    await LinuxCncServer(runtime).run()


SIM_DEVICES = [
    SimDevice(
        name="linuxcnc",
        device="robot",
        section=SimRobotSection,
        links={"linuxcnc": {}},
        main=main,
        faults=simulator.MOTION,
    )
]
