"""Set up a small simulated cell whose robot controller loads program files."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell
from polishd.config.cell import CellConfig, load_config
from polishd.config.controller_profile import CONTROLLER_PROFILE_DIR
from polishd.plugin_loader import plugins_of
from polishd.programs.make import make_program
from polishd.programs.options import EncodingOption, MakeOptions
from tests.system.cell_rig import PATIENT, with_keys, with_part, without, write_small

Kind = Literal["opcua", "ads", "modbus"]
PROFILES: dict[Kind, str] = {"opcua": "plc-opcua", "ads": "plc-ads", "modbus": "plc-modbus"}
TRUTH = {"overhead_s": 0.03, "overhead_spread": 0.5}
"""Additional time per block of that controller, which the plan of the first pass does not know."""
PIT = {"max_stall_removal_nm": 60.0}
"""Permitted removal during a feed hold until an actuator with 0.2 s has taken the force off."""


def write_files(out: Path, kind: Kind, aperture_mm: float, **job: Any) -> DemoFiles:
    """Write the demo's files with a small part and such a controller."""
    files = write_small(out, **job)
    hand_over(files, kind)
    files.sim.write_text(with_keys(files.sim.read_text(), {"hidden_truth": TRUTH}))
    with_part(files, {"aperture_mm": aperture_mm})
    return files


def hand_over(files: DemoFiles, kind: Kind) -> None:
    """Replace the cell's robot with such a controller, whose profile has time limits for a busy machine."""
    shipped = (CONTROLLER_PROFILE_DIR / f"{PROFILES[kind]}.toml").read_text()
    (files.out / "controller.toml").write_text(
        shipped.replace("watchdog_s = 8.0", "watchdog_s = 20.0\nsilence_s = 6.0")
    )
    port = urlsplit(load_config(files.cell).robot.model_dump()["address"]).port or 0
    host = f"127.{port // 256}.{port % 256}.1"
    addresses: dict[Kind, str] = {
        "opcua": f"opc.tcp://127.0.0.1:{port}",
        "ads": f"ads://{host}/{host}.1.1:851",
        "modbus": f"tcp://127.0.0.1:{port}",
    }
    keys = {
        "type": "plc_robot",
        "profile": "controller.toml",
        "address": addresses[kind],
        "delivery": "folder:sim/programs",
        "no_progress_s": PATIENT["robot"]["no_progress_s"],
    }
    section = "\n".join(["[robot]", *(f"{key} = {json.dumps(value)}" for key, value in keys.items())])
    cell = without(files.cell.read_text(), "robot")
    files.cell.write_text(with_keys(f"{cell}\n{section}\n", {"limits": PIT}))


@contextlib.contextmanager
def running(files: DemoFiles, speed: float) -> Iterator[DemoFiles]:
    """Run the simulator of these files for the duration of the block."""
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files


LANGUAGES = {"inform": "yaskawa-inform", "val3": "staubli-val3", "inform over hses": "yaskawa-hses"}
"""Shipped profiles by the language of their programs."""


TIMES, HSES_TIMES = "report_ms = 20.0\nlink_ms = 20.0", "report_ms = 20.0\nlink_ms = 150.0"
"""Time tolerances: where the controller has no clock, a delayed reading looks like a delay of the robot."""


def write_language_cell(out: Path, language: str, encoding: EncodingOption, **job: Any) -> DemoFiles:
    """Write the demo's files with a small part and a program in that language on its controller."""
    files = write_files(out, "opcua", 14.0, **job)
    files.sim.write_text(with_keys(files.sim.read_text(), {"plant": {"pv_nm": 500.0, "rms_nm": 100.0}}))
    profile = (CONTROLLER_PROFILE_DIR / f"{LANGUAGES[language]}.toml").read_text()
    (files.out / "controller.toml").write_text(
        profile.replace("watchdog_s = 8.0\nsilence_s = 2.0", "watchdog_s = 20.0\nsilence_s = 6.0")
        .replace("report_ms = 50.0", "report_ms = 20.0")
        .replace("report_ms = 20.0\nlink_ms = 20.0", HSES_TIMES if language.endswith("hses") else TIMES)
    )
    files.sim.write_text(with_keys(files.sim.read_text(), {"hidden_truth": {"overhead_s": 0.004}}))  # a move and a wait
    cell = files.cell.read_text().replace('format = "rs274"', f'format = "{language.partition(" ")[0]}"')
    if language.endswith("hses"):
        cell = cell.replace("opc.tcp://", "hses://")
    files.cell.write_text(
        with_keys(
            cell,
            {
                "limits": {"max_stall_removal_nm": 120.0 if language.endswith("hses") else 80.0},
                "part": {"edge_mm": 1.0},
            },
        )
    )
    config = load_config(files.cell)
    config.program_path.write_bytes(language_program(config, encoding))
    return files


def language_program(config: CellConfig, encoding: EncodingOption) -> bytes:
    """Return a raster program in the language of the cell."""
    dwell_s = 0.1 if encoding == "dwell" else None
    options = MakeOptions(
        "raster", config.program_path, encoding=encoding, dwell_s=dwell_s, feed_mm_min=300.0, step_mm=1.0, pitch_mm=1.0
    )
    return make_program(options, config, plugins_of(config)).text
