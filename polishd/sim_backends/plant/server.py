"""The process of the plant: takes the devices' reports, wears the part up to the vouched time, keeps the event log."""

from __future__ import annotations

import asyncio
import heapq
import itertools
import json
import math
import os
import signal
import time
import zlib
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from polishd.config.simulator_faults import PANEL, STATES, WIRES
from polishd.model.surface import FloatArray
from polishd.sim_backends.common import hidden_truth, runtime
from polishd.sim_backends.common.runtime import Start, announce, cancel_all, replace_file, until_ended
from polishd.sim_backends.plant import effects
from polishd.sim_backends.plant import part as parts
from polishd.sim_backends.plant.world import Timeline, World

# ``sim.log``: one JSON line for each event, in the order of time.

KEPT = 4000


@dataclass(slots=True)
class SimEventLog:
    """Hold events back until every device has vouched for their time, then write them in order."""

    path: Path
    _heap: list[tuple[float, int, dict[str, Any]]] = field(default_factory=list)
    _number: itertools.count[int] = field(default_factory=itertools.count)
    _wall: list[float] = field(default_factory=list)
    _process: list[float] = field(default_factory=list)

    def add(self, device: str, name: str, at_s: float, **data: Any) -> None:
        """Add an event at that time (time.monotonic)."""
        heapq.heappush(self._heap, (at_s, next(self._number), {"device": device, "event": name, **data}))

    def clock(self, wall_s: float, process_s: float) -> None:
        """Record the relation of the two clocks."""
        self._wall.append(wall_s)
        self._process.append(process_s)
        if len(self._wall) > 2 * KEPT:
            del self._wall[:KEPT], self._process[:KEPT]

    def write(self, until_s: float) -> None:
        """Write all events up to then."""
        lines = []
        while self._heap and self._heap[0][0] <= until_s:
            at_s, _, event = heapq.heappop(self._heap)
            process = float(np.interp(at_s, self._wall, self._process)) if self._wall else 0.0
            lines.append(json.dumps({"mono_s": round(at_s, 6), "process_s": round(process, 6), **event}))
        if lines:
            with self.path.open("a") as file:
                file.write("\n".join(lines) + "\n")


TICK_S = 0.02
SUMMARY_S = 1.0
MOVING = {"motion_started": True, "motion_stopped": False, "boot": False, "lost": False}
DEAF = {"interferometer"}
EXTENDED = {"engage": True, "retracted": False, "boot": False, "lost": False}


@dataclass(slots=True)
class PlantServer:
    """The plant and its devices."""

    start: Start
    world: World
    witness: SimEventLog
    writers: dict[str, asyncio.StreamWriter] = field(default_factory=dict)
    robot_mark: float = math.inf
    moving: bool = False
    extended: bool = False
    safe_s: float = 0.0
    """Last start or stop of the robot or the actuator."""
    asked_s: float | None = None
    """Time of a measurement request that is not served yet."""
    seat: str = ""
    """The part on it; empty where there is none."""
    others: dict[str, parts.TruePart] = field(default_factory=dict)
    """Earlier parts, as they left the plant."""
    write_s: float = math.inf
    """The account is written once all time before that is integrated."""
    _touch_um: float | None = None
    _acting_n: float = 0.0
    _summary: tuple[float, int] = (0.0, -1)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one device, from hello to its end."""
        hello = await runtime.read_frame(reader)
        if not isinstance(hello, dict) or "hello" not in hello:
            writer.close()
            return
        device = str(hello["hello"])
        self._arrive(device, float(hello["t"]), writer)
        while (message := await runtime.read_frame(reader)) is not None:
            if self.writers.get(device) is writer:
                self._hear(device, message)
        if self.writers.get(device) is writer:
            self._leave(device)
        writer.close()

    async def tick(self) -> None:
        """Integrate until cancelled."""
        while True:
            await asyncio.sleep(TICK_S)
            self.advance()

    def advance(self) -> None:
        """Integrate up to the horizon; serve all that waits for it."""
        now = time.monotonic()
        if "robot" not in self.writers:
            self.world.stand_until(now)
        horizon = min(now, self.robot_mark, self.world.force.mark_s, self.world.rpm.mark_s)
        for wall, process in self.world.integrate(horizon):
            self.witness.clock(wall, process)
        self._send_touch()
        self._send_force()
        self._measure(horizon)
        if horizon >= self.write_s:
            self.write_s = math.inf
            self._write(horizon)
        self.witness.write(horizon)

    def mark_way_out(self) -> None:
        """Mark the begin of a fault: from now on a second account books the cost of leaving contact."""
        self.world.mark_way_out(time.monotonic())
        self.witness.add("plant", "way_out_marked", time.monotonic())

    def mark_pit(self) -> None:
        """Mark the begin of a fault outside the cell: from now on an account books the removal beyond plan."""
        now_s = time.monotonic()
        self.world.mark_pit(now_s)
        self.witness.add("plant", "pit_marked", now_s)

    def change(self, part: str) -> None:
        """Take the loader's report: it loaded that part, or with an empty name unloaded the seat."""
        if self.seat:
            self.others[self.seat] = self.world.part
            self._keep(self.seat)
        self.seat = part
        if part:
            seed = self.start.seed + zlib.crc32(part.encode())
            known = part in self.others
            self.world.part = self.others.pop(part) if known else parts.make(self.start.config.plant, seed)
        if "interferometer" in self.writers:
            self.writers["interferometer"].write(runtime.pack_json({"part": part}))

    def again(self) -> None:
        """Read SIM.toml again: truth and tool may change, and later parts have another surface."""
        self.start = self.start.again()
        self.world.mount(self.start.config)
        self.witness.add("plant", "button", time.monotonic(), signal=signal.SIGHUP.name)

    def finish(self) -> None:
        """Write all results at the end."""
        for timeline in (self.world.force, self.world.rpm):
            timeline.mark_s = math.inf
        self.world.integrate(math.inf)
        self._write(time.monotonic())
        self.witness.write(math.inf)

    def _arrive(self, device: str, at_s: float, writer: asyncio.StreamWriter) -> None:
        self.writers[device] = writer
        world = self.world
        if device == "robot":
            world.stand_until(at_s)
            self.robot_mark = at_s
        elif device in {"actuator", "spindle"}:
            self._timeline(device).connect(at_s)
        welcome = {"pose": list(world.pose), "touch_um": world.touch_um, "pitch_mm": world.part.grid.pitch_mm}
        writer.write(runtime.pack_json({**welcome, "origin_px": list(world.part.origin_px), "part": self.seat}))

    def _leave(self, device: str) -> None:
        now = time.monotonic()
        del self.writers[device]
        if device == "robot":
            self.robot_mark = math.inf
        elif device in {"actuator", "spindle"}:
            stays = device == "actuator" and self.start.config.actuator.unpowered == "stays"
            self._timeline(device).disconnect(now, stays=stays)
        self._note(device, "lost", now, {})

    def _timeline(self, device: str) -> Timeline:
        return self.world.force if device == "actuator" else self.world.rpm

    def _hear(self, device: str, message: runtime.Message | FloatArray) -> None:
        if not isinstance(message, dict):
            self.world.move(message)
            self._summarise(message)
        elif "event" in message:
            self._note(device, message.pop("event"), message.pop("t"), message)
        elif "pace" in message:
            self.world.pace.step(float(message["t"]), float(message["pace"]))
        elif "measure" in message:
            self.asked_s = float(message["t"])
        elif "part" in message:
            self.change(message["part"])
        elif device == "robot":
            self.robot_mark = float(message["mark"])
            self.world.stand_until(self.robot_mark, message["pose"])
        elif "samples" in message:
            self._timeline(device).push(message["samples"], float(message["mark"]))
            self._send_force()

    def _note(self, device: str, name: str, at_s: float, data: runtime.Message) -> None:
        if device == "robot" and name in MOVING:
            self.moving, self.safe_s = MOVING[name], max(at_s, self.safe_s)
        if device == "actuator" and name in EXTENDED:
            self.extended, self.safe_s = EXTENDED[name], max(at_s, self.safe_s)
        if device == "loader":
            data = {**data, "robot_moves": self.moving, "tool_is_out": self.extended}
        if device == "actuator" and name == "force_setpoint" and data["force_n"] > 0.0:
            self.world.set_point.step(at_s, data["force_n"])
        if name == "fault_begins" and data["what"] in (*STATES, *PANEL, *WIRES):
            self.world.mark_pit(at_s)
        if name == "program_loaded":
            self.world.account.load(data["sha256"], data["blocks"])
        self.witness.add(device, name, at_s, **data)
        if name in {"motion_stopped", "lost"}:
            self.write_s = at_s

    def _summarise(self, rows: FloatArray) -> None:
        """Report block starts, about once a second."""
        seq, wall = int(rows[-1, 0]), float(rows[-1, 2])
        since, last = self._summary
        if seq < last or wall - since > SUMMARY_S:
            self._summary = (wall, seq)
            self.witness.add("robot", "blocks", wall, at_seq=seq)

    def _send_touch(self) -> None:
        touch_um = self.world.touch_um
        if touch_um != self._touch_um and "actuator" in self.writers:
            self._touch_um = touch_um
            self.writers["actuator"].write(runtime.pack_json({"touch_um": touch_um}))

    def _send_force(self) -> None:
        """Send the true contact between tool and part to the devices that feel it, or whose faults begin by it."""
        acting_n = self.world.acting_n
        if acting_n != self._acting_n:
            self._acting_n = acting_n
            for device in self.writers.keys() - DEAF:
                self.writers[device].write(runtime.pack_json({"acting_n": acting_n}))

    def _measure(self, horizon_s: float) -> None:
        if self.asked_s is None or horizon_s < max(self.asked_s, self.safe_s) or self.moving or self.extended:
            return
        if not self.seat:
            return
        self.asked_s = None
        since_s = (horizon_s - self.world.polished_s) * self.start.speed
        seen = self.world.part.map_nm() + parts.swelling_nm(self.world.part, self.start.config, since_s)
        rms, pv = self.world.part.stats()
        self.witness.add("plant", "measured", horizon_s, true_rms_nm=round(rms, 4), true_pv_nm=round(pv, 4))
        self._write(horizon_s)
        if self.world.part.patch is not None:
            self.world.part.patch.write_map(self.start.state / "patch.dat", self.seat)
        if "interferometer" in self.writers:
            self.writers["interferometer"].write(runtime.pack_rows(seen))

    def _keep(self, name: str) -> None:
        """Save the truth of a part that is unloaded."""
        folder = self.start.state / "parts"
        folder.mkdir(exist_ok=True)
        self.world.part.write(folder / f"{quote(name, safe='')}.npz")

    def _write(self, until_s: float) -> None:
        self.world.account.write(self.start.state, self.world.part, self.world.process_s, until_s)


def build(start: Start) -> PlantServer:
    """Draw the truth, make the part, save both in the state folder."""
    config = start.config
    hidden = hidden_truth.draw(config.hidden_truth, start.seed, config.robot_model())
    part = parts.from_map(start.surface, config.plant) if start.surface else parts.make(config.plant, start.seed)
    rng = hidden_truth.stream(start.seed, "plant")
    drawn = effects.draw(config, start.seed)
    world = World(config, hidden, part, rng, config.robot.home, time.monotonic(), effects=drawn)
    log = start.state / "sim.log"
    log.unlink(missing_ok=True)
    rms, pv = part.stats()
    witness = SimEventLog(log)
    witness.add("plant", "boot", time.monotonic(), seed=start.seed, true_rms_nm=round(rms, 4), true_pv_nm=round(pv, 4))
    truth = {**asdict(hidden), "effects": asdict(drawn)}
    replace_file(start.state / "truth.json", json.dumps(truth, indent=1, default=np.ndarray.tolist).encode())
    return PlantServer(start, world, witness, seat=config.plant.part_id)


async def main(start: Start) -> None:
    """Run the process of the plant."""
    server = build(start)
    path = start.state / runtime.SOCKET
    path.unlink(missing_ok=True)
    folder = os.open(start.state, os.O_RDONLY | os.O_DIRECTORY)
    stop = asyncio.Event()
    listener = await asyncio.start_unix_server(server.serve, runtime.socket_path(folder), limit=1 << 26)
    announce("plant", str(path))
    asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, server.mark_way_out)
    asyncio.get_running_loop().add_signal_handler(signal.SIGUSR2, server.mark_pit)
    asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, server.again)
    async with asyncio.TaskGroup() as group:
        group.create_task(server.tick())
        await until_ended(stop)
        listener.close()
        cancel_all()
    server.finish()
