"""``python -m polishd.sim_backends SIM.toml``: the supervisor; with ``--device NAME`` one device of a running cell."""

from __future__ import annotations

import argparse
import asyncio
import fcntl
import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from polishd.model.errors import ConfigError, PolishdError
from polishd.sim_backends.common.hidden_truth import stream
from polishd.sim_backends.common.registry import find_device
from polishd.sim_backends.common.runtime import (
    ROOT,
    Start,
    as_hardware,
    read_config,
    replace_file,
    run_device,
    until_ended,
)

# Starts the cell's processes, names them, and ends them. Restarts none: what died stays dead until it is booted.

DEVICES = ("robot", "actuator", "spindle", "interferometer", "loader", "force_sensor", "monitor")
"""Sections of SIM.toml that are a process each, in the order in which they start."""
READY_S = 120.0
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


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parse = argparse.ArgumentParser(prog="polishd sim", description="The simulated polishing cell.")
    parse.add_argument("config", type=Path, metavar="SIM.toml")
    parse.add_argument("--state", type=Path, help="state folder (default: sim beside SIM.toml)")
    parse.add_argument("--seed", type=int, help="overrides plant.seed")
    parse.add_argument("--speed", type=float, help="process seconds per wall second; overrides plant.speed")
    parse.add_argument("--surface", type=Path, help="start from this MetroPro map")
    parse.add_argument("--artefact", type=Path, metavar="FILE", help="write one map of the artefact, and end")
    parse.add_argument("--device", choices=("plant", *DEVICES), help="run one device of the cell in this state folder")
    parse.add_argument("--only", action="append", choices=DEVICES, help="start these alone; may be given again")
    parse.add_argument("--rebooted", action="store_true", help=argparse.SUPPRESS)
    return parse


def start_of(options: argparse.Namespace) -> Start:
    """What was asked for; a device booted by hand takes seed and speed of the running cell."""
    config = read_config(options.config)
    state: Path = (options.state or options.config.parent / "sim").absolute()
    state.mkdir(parents=True, exist_ok=True)
    running: dict[str, Any] = {}
    if options.device and (state / "endpoints.json").exists():
        running = json.loads((state / "endpoints.json").read_text())
    seed = options.seed if options.seed is not None else running.get("seed", config.plant.seed)
    speed = options.speed if options.speed is not None else running.get("speed", config.plant.speed)
    only = tuple(options.only or ())
    config.require_simulated((options.device,) if options.device else only or DEVICES)
    return Start(config, state, int(seed), float(speed), options.surface, options.rebooted, only)


def main() -> int:
    """Run; the exit code."""
    options = parser().parse_args()
    code = 0
    try:
        if options.artefact is not None:
            return _artefact(options)
        start = start_of(options)
        if options.surface is not None and options.device in {None, "plant"}:
            _check(options.surface)
        code = asyncio.run(_run(start, options.device))
    except* (PolishdError, OSError) as group:
        error: BaseException = group
        while isinstance(error, BaseExceptionGroup):
            error = error.exceptions[0]
        print(f"polishd sim: {error}", file=sys.stderr)  # noqa: T201
        code = error.exit_code if isinstance(error, PolishdError) else 5
    return code


async def _run(start: Start, device: str | None) -> int:
    if device is None:
        arguments = [argument for argument in sys.argv[1:] if argument != "--rebooted"]
        with _alone(start.state):
            return await SimSupervisor(start, arguments).run()
    as_hardware()
    if device == "plant":
        from polishd.sim_backends.plant.server import main as plant

        await plant(start)
        return 0
    await run_device(device, start, find_device(start.config, device).main)
    return 0


@contextmanager
def _alone(state: Path) -> Iterator[None]:
    """Hold the state folder of a simulated cell; ConfigError while another cell runs in it.

    A second cell would replace the terminals and the socket of the first one. The kernel drops the lock at any end of
    its holder; the children do not inherit it.
    """
    with (state / ".lock").open("a") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ConfigError(
                f"{state}: a simulated cell already runs in this folder. Use it, end it (Ctrl-C in its terminal), "
                "or name another folder with --state"
            ) from error
        yield


def _artefact(options: argparse.Namespace) -> int:
    from polishd.sim_backends.interferometer import write_artefact

    config = read_config(options.config)
    seed = config.plant.seed if options.seed is None else options.seed
    write_artefact(config, options.artefact, stream(seed, "artefact"))
    return 0


def _check(surface: Path) -> None:
    """Refuse a map that cannot be read before anything is started."""
    from polishd.sim_backends.common import metropro

    metropro.read(surface)


if __name__ == "__main__":
    sys.exit(main())
