"""The controller's process: three servers, its clock, its operator's buttons, and reports to the plant."""

from __future__ import annotations

import asyncio
import gc
import hashlib
import re
import signal
import time
from collections.abc import Callable, Iterator

import numpy as np

from polishd.sim_backends import truth
from polishd.sim_backends.faults.outlet import FaultyLink
from polishd.sim_backends.runtime import SimRuntime
from polishd.sim_backends.universal_robots import dashboard, primary
from polishd.sim_backends.universal_robots.arm import UrArm
from polishd.sim_backends.universal_robots.controls import BLOCK_REGISTER
from polishd.sim_backends.universal_robots.dashboard import Dashboard
from polishd.sim_backends.universal_robots.machine import UrController
from polishd.sim_backends.universal_robots.rtde import InputOwnership, RtdeClient
from polishd.sim_backends.universal_robots.turning import wrist_deg
from polishd.sim_backends.wire import Feed, SimWire

TICK_S = 0.004
STATE_S = 0.1
READ_S = 0.005
"""Of a turn, while a script is read."""
_BLOCKS = re.compile(rf"(?:polishd_at\(|write_output_integer_register\({BLOCK_REGISTER}, )(\d+)\)")


class UniversalRobotServer:
    """Everything that the process holds."""

    def __init__(self, runtime: SimRuntime) -> None:
        start, config = runtime.start, runtime.start.config.robot
        hidden = truth.draw(start.config.truth, start.seed)
        arm = UrArm.at(tuple(runtime.link.welcome.get("pose") or config.home))
        self.machine = UrController(
            config, arm, 1.0 / config.cycle_hz, hidden.overhead_s, start.speed, time.monotonic()
        )
        self.machine.complain = self.complain
        runtime.script.suffer = self.machine.override.suffer
        self._runtime = runtime
        self._held = InputOwnership()
        self._rtde: list[RtdeClient] = []
        self._primary: list[FaultyLink] = []
        self._waiting: list[tuple[Callable[[], bool], Callable[[], None]]] = []
        self._blocks = 0
        """Of the script that was loaded last."""
        self._loading: Iterator[None] = iter(())
        self._moved = False
        self._seen = (self.machine.runtime, self.machine.safety_mode)

    async def run(self) -> None:
        """Tick for ever."""
        next_state = 0.0
        while True:
            self.advance()
            self._go_on_loading()
            if time.monotonic() >= next_state:
                next_state = time.monotonic() + STATE_S
                for outlet in self._primary:
                    outlet.send(primary.message(primary.STATE, b"\0" * 16))
            await asyncio.sleep(TICK_S)

    def advance(self) -> None:
        """Frames up to the present, a sample after each, and the plant's rows."""
        machine = self.machine
        for _ in machine.due(time.monotonic()):
            before_s = machine.time_s
            machine.frame()
            for client in self._rtde:
                client.tick(before_s)
        self._report()
        due, self._waiting = self._waiting, []
        for condition, then in due:
            if condition():
                then()
            else:
                self._waiting.append((condition, then))

    def rtde(self, outlet: FaultyLink) -> Feed:
        """A client of RTDE."""
        client = RtdeClient(self.machine, self._held, outlet.send, outlet.backlog)
        self._rtde.append(client)

        def closed() -> None:
            client.closed()
            self._rtde.remove(client)

        outlet.on_closed = closed
        return self._now(client.feed)

    def dashboard(self, outlet: FaultyLink) -> Feed:
        """A client of the dashboard."""
        served = Dashboard(self.machine, outlet.send, lambda when, then: self._waiting.append((when, then)))
        return self._now(served.feed)

    def primary(self, outlet: FaultyLink) -> Feed:
        """A client that sends scripts."""
        self._primary.append(outlet)
        outlet.on_closed = lambda: self._primary.remove(outlet)
        return self._now(primary.ScriptIntake(self.load).feed)

    def load(self, text: str) -> None:
        """A script came: what runs is stopped at once, and it is read a part in each turn."""
        self._loading = self._load(text)
        self._go_on_loading()

    def _go_on_loading(self) -> None:
        """A turn's part. Its half a million objects stay for good: no collection is to look through them."""
        until_s = time.monotonic() + READ_S
        for _ in self._loading:
            gc.freeze()
            if time.monotonic() >= until_s:
                return

    def _load(self, text: str) -> Iterator[None]:
        turned_s, longest_s = time.monotonic(), 0.0
        for _ in self.machine.loading(text):
            yield
            longest_s, turned_s = max(longest_s, time.monotonic() - turned_s), time.monotonic()
        runs = self.machine.program is not None
        self._blocks = max(map(int, _BLOCKS.findall(text)), default=0) + 1
        sha256 = hashlib.sha256(text.encode()).hexdigest()
        self._runtime.link.event(
            "program_loaded", sha256=sha256, blocks=self._blocks, runs=runs, longest_turn_s=round(longest_s, 4)
        )

    def complain(self, line: int, text: str) -> None:
        """Tell who sent the script."""
        self._runtime.link.event("complaint", line=line, text=text)
        for outlet in self._primary:
            outlet.send(primary.complaint(line, text))

    def _now(self, feed: Feed) -> Feed:
        """What comes acts from now on, and not on frames that this process was kept from."""

        def act(data: bytes) -> None:
            self.advance()
            feed(data)

        return act

    def _report(self) -> None:
        """Tell the plant what moved since the last time, and vouch for it."""
        machine, link, now = self.machine, self._runtime.link, time.monotonic()
        rows = np.array(machine.rows).reshape(-1, 9)
        machine.rows.clear()
        for at_s, share in machine.shares:
            link.pace(share, at_s)
            machine.share = share
        machine.shares.clear()
        rows[rows[:, 0] >= self._blocks, 0] = -1.0  # of a script that is none of polishd's
        moved = bool(len(rows)) or machine.active
        if moved and not self._moved:
            link.event("motion_started", float(rows[0, 1]) if len(rows) else now)
        mark = machine.wall_s()
        link.rows(rows, mark, (*machine.arm.place.xyz_mm, *wrist_deg(machine.arm.place.turn)))
        if self._moved and not moved:
            link.event("motion_stopped", mark)
        seen = (machine.runtime, machine.safety_mode)
        if seen != self._seen:
            link.event("controller", mark, runtime=machine.runtime, safety_mode=machine.safety_mode)
        self._moved, self._seen = moved, seen


async def main(runtime: SimRuntime) -> None:
    """The device coroutine."""
    server, config = UniversalRobotServer(runtime), runtime.start.config.robot
    receivers = {"rtde": server.rtde, "dashboard": server.dashboard, "primary": server.primary}
    wires = [SimWire(runtime, receive, link) for link, receive in receivers.items()]
    address = await wires[0].open_tcp(config.port)
    await wires[1].open_tcp(config.dashboard_port or config.port + 1, dashboard.GREETING)
    await wires[2].open_tcp(config.primary_port or config.port + 2)
    machine = server.machine
    runtime.button(signal.SIGUSR1, machine.emergency_stop)
    runtime.button(signal.SIGUSR2, machine.pause)
    wires[0].ready(f"tcp://{address}")
    await server.run()
