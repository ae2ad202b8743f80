"""Cells of the campaign, and what goes wrong in each: a robot that stands or is slow, a force that is wrong."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell
from tests.campaigns.faults import links as f
from tests.system import fanuc_rmi_rig, linuxcnc_rig, plc_robot_rig
from tests.system.cell_rig import PATIENT, Daemon, Sections, with_faults, with_keys, write_small
from tests.system.test_profiled_cell import ACTUATOR, with_section

Fault = Mapping[str, Any]

CONTACT_S = 3.0
"""In contact before a fault: on a busy computer the robot takes its time to go on from where the tool landed."""
JOB = {"tolerance_nm": 5.0, "max_cycles": 1}
QUICK: Sections = {"spindle": {"spin_s": 0.5}, "interferometer": {"write_s": 0.02}}
"""Before contact nothing is lost."""
IN_CONTACT = {"contact_s": CONTACT_S}
AT_LANDING = {"at_s": 0.0}

MOTION: Mapping[str, Fault] = {
    "stands, reports running": {"what": "stand", **IN_CONTACT},
    "override 0 %": {"what": "override", "percent": 0.0, **IN_CONTACT},
    "override 50 %": {"what": "override", "percent": 50.0, **IN_CONTACT},
    "override to 50 % in 2 s": {"what": "override", "percent": 50.0, "ramp_s": 2.0, **IN_CONTACT},
}
SILENT: Mapping[str, Fault] = {
    "override 50 %, not reported": {**MOTION["override 50 %"], "reported": False},
    "override to 50 % in 2 s, not reported": {**MOTION["override to 50 % in 2 s"], "reported": False},
}
STOPPED: Mapping[str, Fault] = {
    name: {**fault, **IN_CONTACT} for name, fault in {"unplugged": f.LOST["unplugged"], **f.PANEL, **f.KILLED}.items()
}
"""Of a robot whose controller runs a program."""
FORCE: Mapping[str, Fault] = {
    "spike of 36 N": {"what": "spike", "force_n": 36.0, **IN_CONTACT},
    "lands with 49 N": {"what": "press", "force_n": 49.0, **AT_LANDING},
}
LIE: Mapping[str, Fault] = {"presses 16 N, reads 12 N": {"what": "lie", "offset_n": -4.0, **IN_CONTACT}}
TOUCH: Mapping[str, Fault] = {"touch-off with 33 N": {"what": "press", "force_n": 33.0, **AT_LANDING}}


@dataclass(frozen=True, slots=True)
class Link:
    """A cell with one robot link, or one actuator."""

    device: str
    write: Callable[[Path], DemoFiles]
    faults: Mapping[str, Fault]
    parts: tuple[str, ...]
    """Sources that its results depend on, beside those that all share."""
    linuxcnc: bool = False
    unnoticed: tuple[str, ...] = field(default=())
    """Faults that nothing in this cell can notice: the check says what they cost."""

    def files(self, folder: Path, fault: str) -> DemoFiles:
        """The cell with that fault in its script; without progress it is left as early as by default."""
        files = self.write(folder)
        files.cell.write_text(_without(files.cell.read_text(), "no_progress_s"))
        sim, scripted = with_keys(files.sim.read_text(), QUICK), {"device": self.device, **self.faults[fault]}
        files.sim.write_text(with_faults(sim, *([] if scripted["what"] == f.KILL else [scripted])))
        return files

    @contextlib.contextmanager
    def running(self, files: DemoFiles) -> Iterator[Callable[[], Daemon]]:
        """Run its simulator at speed 1, and give what starts the daemon."""
        if self.linuxcnc:
            with linuxcnc_rig.linuxcnc_cell(files) as cell:
                yield cell.daemon
            return
        options = ["--state", str(files.sim_dir), "--seed", "3", "--speed", "1"]
        with simulated_cell(files.sim, options, files.out / "sim.stderr"):
            yield lambda: Daemon(files, "--no-hold")


def _demo(write: Callable[[Path], DemoFiles], folder: Path) -> DemoFiles:
    """The cell that the fault matrix has, for one pass."""
    files = write(folder)
    files.cell.write_text(with_keys(files.cell.read_text(), {"job": JOB}))
    return files


def _fanuc(folder: Path) -> DemoFiles:
    return fanuc_rmi_rig.write_files(folder, **JOB)


def _plc(kind: plc_robot_rig.Kind, folder: Path) -> DemoFiles:
    """With a controller that takes as long for a block as is planned: what it costs beyond that is another matter."""
    files = plc_robot_rig.write_files(folder, kind, 30.0, **JOB)
    files.sim.write_text(_without(files.sim.read_text(), *plc_robot_rig.TRUTH))
    return files


def _hses(folder: Path) -> DemoFiles:
    """Without the time that a block costs beyond its plan, as ``_plc``, and with the delays of the shipped profile."""
    files = plc_robot_rig.write_language_cell(folder, "inform over hses", "dwell", **JOB)
    files.sim.write_text(_without(files.sim.read_text(), *plc_robot_rig.TRUTH))
    profile = files.out / "controller.toml"
    profile.write_text(profile.read_text().replace(plc_robot_rig.HSES_TIMES, plc_robot_rig.TIMES))
    files.cell.write_text(with_keys(files.cell.read_text(), {"limits": {"max_stall_removal_nm": 80.0}}))
    return files


def _without(text: str, *keys: str) -> str:
    """The TOML text less those keys."""
    return "".join(f"{line}\n" for line in text.splitlines() if line.partition("=")[0].strip() not in keys)


def _linuxcnc(folder: Path) -> DemoFiles:
    files = write_small(folder, patient=False, **JOB)
    linuxcnc_rig.take(files)
    files.cell.write_text(with_keys(files.cell.read_text(), PATIENT))
    return files


def _profiled(folder: Path) -> DemoFiles:
    files = write_small(folder, **JOB)
    cell = files.cell.read_text()
    files.cell.write_text(with_section(cell, "actuator", ACTUATOR))
    return files


def _sensed(folder: Path) -> DemoFiles:
    files = _demo(f._sensed, folder)
    head, _, rest = files.cell.read_text().partition("\n[monitor]\n")  # whose device this cell has not
    files.cell.write_text(f"{head}\n[{rest.partition(chr(10) + '[')[2]}" if "\n[" in rest else f"{head}\n")
    return files


def _touching(folder: Path) -> DemoFiles:
    """With a touch-off before the pass: at most 1 N, at three places of the part's rim."""
    return write_small(folder, patient=False, touch_off=True, **JOB)


def _robot(write: Callable[[Path], DemoFiles], faults: Mapping[str, Fault], driver: str, simulator: str) -> Link:
    parts = (f"polishd/drivers/{driver}", f"polishd/sim_backends/{simulator}")
    return Link("robot", write, faults, parts)


def _actuator(write: Callable[[Path], DemoFiles], faults: Mapping[str, Fault] = FORCE, **how: Any) -> Link:
    return Link("actuator", write, faults, ("polishd/drivers/profile_device", "polishd/sim_backends/actuator"), **how)


ALL = {**MOTION, **SILENT}
ROBOT = {**ALL, **STOPPED}
LINKS: Mapping[str, Link] = {
    "robot link": _robot(partial(_demo, f._small), ALL, "robot_link", "robot"),
    "Universal Robots": _robot(partial(_demo, f._universal), ALL, "universal_robots", "universal_robots"),
    "ABB": _robot(partial(_demo, f._abb), ROBOT, "abb_rws", "abb_rws"),
    "FANUC RMI": _robot(_fanuc, ROBOT, "fanuc_rmi", "fanuc_rmi"),
    "KUKA": _robot(partial(_demo, f._kuka), ROBOT, "kuka_kvp", "kuka_kvp"),
    "PLC robot, OPC UA": _robot(partial(_plc, "opcua"), ALL, "plc_robot", "plc_robot"),
    "PLC robot, ADS": _robot(partial(_plc, "ads"), ALL, "plc_robot", "plc_robot"),
    "PLC robot, Modbus": _robot(partial(_plc, "modbus"), ALL, "plc_robot", "plc_robot"),
    "Yaskawa HSES": _robot(_hses, ROBOT, "plc_robot", "plc_robot"),
    "LinuxCNC": Link(
        "robot", _linuxcnc, MOTION, ("polishd/drivers/linuxcnc", "polishd/sim_backends/linuxcnc"), linuxcnc=True
    ),
    "actuator, Modbus RTU": _actuator(partial(_demo, f._small), {**FORCE, **LIE}, unnoticed=tuple(LIE)),
    "actuator, Modbus TCP": _actuator(partial(_demo, lambda out: f._actuator(out, "modbus_tcp"))),
    "actuator, lines": _actuator(partial(_demo, lambda out: f._actuator(out, "serial"))),
    "actuator, CiA 402": Link(
        "actuator", partial(_demo, f._cia402), FORCE, ("polishd/drivers/cia402", "polishd/sim_backends/cia402")
    ),
    "actuator, profile": _actuator(_profiled),
    "actuator beside a force sensor": _actuator(_sensed, {**FORCE, **LIE}),
    "actuator, touch-off": _actuator(_touching, TOUCH),
}
CASES = [(name, fault) for name, link in LINKS.items() for fault in link.faults]
