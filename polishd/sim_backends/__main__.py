"""``python -m polishd.sim_backends SIM.toml``: the supervisor; with ``--device NAME`` one device of a running cell."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from pathlib import Path
from typing import Any

from polishd.config.simulator import SimConfig, load_simulator
from polishd.model.errors import PolishdError
from polishd.sim_backends.runtime import Start, as_hardware, read_config, run_device
from polishd.sim_backends.supervisor import DEVICES, SimSupervisor
from polishd.sim_backends.truth import stream

CAN = ("slcan", "socketcand")
"""Kinds of an actuator behind a drive."""


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
        return await SimSupervisor(start, arguments).run()
    as_hardware()
    if device == "plant":
        from polishd.sim_backends.plant.server import main as plant

        await plant(start)
        return 0
    await run_device(device, start, _device(device, start.config))
    return 0


def _device(name: str, config: SimConfig) -> Any:
    """A device's coroutine, loaded late: a drive needs no scipy."""
    from importlib import import_module

    robot = {"link": "robot", "opcua": "handover", "ads": "handover", "modbus": "handover"}
    module, main = {
        "robot": (f"{robot.get(config.robot.kind, config.robot.kind)}.server", "main"),
        "interferometer": ("interferometer", "main"),
        "spindle": ("cia402.device", "spindle") if config.spindle.drive == "cia402" else ("spindle.device", "main"),
        "actuator": ("cia402.device", "actuator") if config.actuator.kind in CAN else ("actuator.device", "main"),
    }.get(name, (f"{name}.device", "main"))
    return getattr(import_module(f"polishd.sim_backends.{module}"), main)


def _artefact(options: argparse.Namespace) -> int:
    from polishd.sim_backends.interferometer import write_artefact

    config = load_simulator(options.config)
    seed = config.plant.seed if options.seed is None else options.seed
    write_artefact(config, options.artefact, stream(seed, "artefact"))
    return 0


def _check(surface: Path) -> None:
    """Refuse a map that cannot be read before anything is started."""
    from polishd.sim_backends import metropro

    metropro.read(surface)


if __name__ == "__main__":
    sys.exit(main())
