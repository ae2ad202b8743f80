"""Starts the cell's processes, names them, and ends them. Restarts none: what died stays dead until it is booted."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from dataclasses import dataclass, field
from typing import Any

from polishd.sim_backends.runtime import ROOT, Start, replace_file, until_ended

DEVICES = ("robot", "actuator", "spindle", "interferometer", "loader", "force_sensor", "monitor")
READY_S = 30.0
END_S = 5.0
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(slots=True)
class SimSupervisor:
    """The parent of one simulated cell."""

    start: Start
    arguments: list[str]
    """Command line that the children get, before ``--device``."""
    children: dict[str, asyncio.subprocess.Process] = field(default_factory=dict)
    ends: dict[str, asyncio.Task[None]] = field(default_factory=dict)
    endpoints: dict[str, str] = field(default_factory=dict)
    terminals: dict[str, str] = field(default_factory=dict)
    """Where the links of devices on serial lines led when they came up."""
    stop: asyncio.Event = field(default_factory=asyncio.Event)

    async def run(self) -> int:
        """From nothing to READY to nothing; the exit code."""
        for name in ("endpoints.json", "pids.json"):
            (self.start.state / name).unlink(missing_ok=True)
        async with asyncio.TaskGroup() as group:
            end = group.create_task(until_ended(self.stop))
            begin = group.create_task(self._begin(group))
            await asyncio.wait({end, begin}, return_when=asyncio.FIRST_COMPLETED)
            up = begin.done() and begin.result()
            begin.cancel()
            if up:
                self._announce()
                await self.stop.wait()
            self.stop.set()
            await self._end()
        return 0 if up else 1

    async def _begin(self, group: asyncio.TaskGroup) -> bool:
        """Plant first, then its devices; whether all came up."""
        if not await self._spawn("plant", group):
            return False
        wanted = self.start.only or DEVICES
        devices = [name for name in DEVICES if name in wanted and getattr(self.start.config, name) is not None]
        return all(await asyncio.gather(*(self._spawn(name, group) for name in devices)))

    async def _spawn(self, name: str, group: asyncio.TaskGroup) -> bool:
        path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
        child = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "polishd.sim_backends",
            *self.arguments,
            "--device",
            name,
            stdout=asyncio.subprocess.PIPE,
            stdin=asyncio.subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": path, **dict.fromkeys(THREADS, "1")},
        )
        self.children[name] = child
        self.ends[name] = group.create_task(self._mourn(name, child))
        try:
            async with asyncio.timeout(READY_S):
                line = await _line(child)
        except TimeoutError:
            line = b""
        if not line:
            print(f"polishd sim: the {name} did not come up", file=sys.stderr)  # noqa: T201
            return False
        self.endpoints[name] = str(json.loads(line)["endpoint"])
        link = self.start.state / name
        if link.is_symlink():
            self.terminals[name] = str(link.readlink())
        return True

    def _announce(self) -> None:
        plant = self.start.config.plant
        message: dict[str, Any] = {
            **self.endpoints,
            "seed": self.start.seed,
            "speed": self.start.speed,
            "part_id": plant.part_id,
            "state": str(self.start.state),
        }
        pids = {"supervisor": os.getpid(), **{name: child.pid for name, child in self.children.items()}}
        replace_file(self.start.state / "pids.json", json.dumps(pids, indent=1).encode())
        replace_file(self.start.state / "endpoints.json", json.dumps(message, indent=1).encode())
        print(f"READY {json.dumps(message)}", flush=True)  # noqa: T201

    async def _mourn(self, name: str, child: asyncio.subprocess.Process) -> None:
        """Note a death; without the plant there is no cell."""
        await child.wait()
        self._unplug(name)
        if not self.stop.is_set():
            print(f"polishd sim: the {name} has ended", file=sys.stderr)  # noqa: T201
        if name == "plant":
            self.stop.set()

    def _unplug(self, name: str) -> None:
        """Take away the link to the terminal of a device that was killed: its number may be any program's next."""
        link = self.start.state / name
        if link.is_symlink() and str(link.readlink()) == self.terminals.get(name):
            link.unlink()

    async def _end(self) -> None:
        """Devices first, then the plant, so that it books all that they did."""
        for names in (DEVICES, ("plant",)):
            living = {self.ends[name]: child for name, child in self.children.items() if name in names}
            for child in living.values():
                if child.returncode is None:
                    child.send_signal(signal.SIGTERM)
            late = (await asyncio.wait(living, timeout=END_S))[1] if living else set()
            for end in late:
                living[end].kill()


async def _line(child: asyncio.subprocess.Process) -> bytes:
    return await child.stdout.readline() if child.stdout is not None else b""
