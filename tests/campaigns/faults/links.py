"""Links of a cell in contact: how a cell with each is written, how long each may be silent, and its faults."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, free_port, with_values
from polishd.config import simulator_faults
from tests.campaigns.result_files import ACTING
from tests.system import abb_rig, fanuc_rmi_rig, kuka_rig, plc_robot_rig, universal_robots_rig
from tests.system.agreement import LEAST_S
from tests.system.cell_rig import ONE_PASS, Sections, with_keys, write_small
from tests.system.test_cia402 import ACTUATOR, SPINDLE
from tests.system.test_force_and_signals import MONITOR, SENSOR

Fault = Mapping[str, Any]

SILENCE_S = 1.0
"""Of each link here: long enough for a busy machine, short enough for a fault to cost seconds only."""
PLC_SILENCE_S = 3.0
FANUC_SILENCE_S = fanuc_rmi_rig.QUICK["robot"]["silence_s"]
READING_S = 0.1
"""Most between two readings of HSES on a busy machine; each 20 ms otherwise."""
QUIET = {"rate": 1.0, "duration_s": 60.0}
LOST: Mapping[str, Fault] = {
    "hangs": {"what": "hang"},
    "unplugged": {"what": "unplug", "duration_s": 60.0},
    "reboots": {"what": "reboot"},
}
"""The link carries nothing any more: contact must end."""
TIMES: Mapping[str, Fault] = {
    "late by 0.1 s": {"what": "delay", "by_s": 0.1},
    "late by 3 limits": {"what": "late_reply", "by_s": 3 * SILENCE_S},
    "dribbles": {"what": "dribble", "by_s": 0.002},
}
FRAMES: Mapping[str, Fault] = {
    "frame lost": {"what": "drop"},
    "frame twice": {"what": "duplicate"},
    "bit turned": {"what": "garble"},
    "frame to it lost": {"what": "drop", "direction": "to_device"},
    "bit turned on the way to it": {"what": "garble", "direction": "to_device"},
    "all garbled": {"what": "garble", **QUIET},
}
DATAGRAMS: Mapping[str, Fault] = {
    **{name: fault for name, fault in FRAMES.items() if fault["what"] != "garble"},
    "all lost": {"what": "drop", **QUIET},
}
"""Of UDP, whose checksum makes a damaged datagram a lost one."""
UNIT: Mapping[str, Fault] = {"another unit answers": {"what": "wrong_unit"}}
REFUSES: Mapping[str, Fault] = {"exception": {"what": "exception"}}
"""Of links that answer requests in contact; the robot link reports without a request."""
PANEL: Mapping[str, Fault] = {"emergency stop": {"what": "estop"}, "switched to manual": {"what": "manual"}}
"""The operator stops a robot at its panel."""
KILL = "kill"
"""Not a fault of SIM.toml: the campaign kills the daemon."""
KILLED: Mapping[str, Fault] = {"daemon killed": {"what": KILL}}
ALL = {**LOST, **TIMES, **FRAMES}
ROBOT = {**ALL, **PANEL, **KILLED}
"""Of a robot whose controller runs a program."""
MUST_END = {*LOST, "all garbled", "all lost", "sticks", "halts", "freezes", "drifts", "saturates", *PANEL, *KILLED}
"""Of a link that contact needs."""


QUICK: Sections = {"actuator": {"land_s": 0.5}, "spindle": {"spin_s": 0.5}, "interferometer": {"write_s": 0.02}}
"""Short times before contact, where no fault acts yet. The time to lift the tool stays: it is measured."""
COMMON = (
    *ACTING,
    "polishd/drivers/transport",
    "polishd/sim_backends/common",
    "tests/campaigns/faults",
)
"""Sources that each case depends on."""


@dataclass(frozen=True, slots=True)
class Link:
    """A cell whose link has the faults."""

    device: str
    write: Callable[[Path], DemoFiles]
    faults: Mapping[str, Fault]
    silence_s: float = SILENCE_S
    link: str = ""
    """Name of the link, where the robot has several."""
    needed: bool = True
    """Whether contact needs it; else its loss has no effect until it is used."""
    driver: str = "profile_device"
    """Folder in polishd/drivers."""
    clock: bool = True
    """Whether the controller reports the time of its state; without it block times are those of readings, wall time."""
    simulator: str = ""
    """Folder in polishd/sim_backends, where its name is not that of the device."""

    def files(self, folder: Path, **sim: Mapping[str, Any]) -> DemoFiles:
        """Return the files of the cell, quick where nothing is measured; ``sim``: keys of SIM.toml."""
        files = self.write(folder)
        files.cell.write_text(with_keys(files.cell.read_text(), {"metrology": {"stable_s": 0.1}}))
        files.sim.write_text(with_keys(with_keys(files.sim.read_text(), QUICK), sim))
        return files

    def loses(self) -> bool:
        """Whether its losses in contact can be counted."""
        return self.needed and {"hangs", "unplugged"} <= self.faults.keys()

    def parts(self) -> tuple[str, ...]:
        """Return files and folders that its results depend on."""
        return (
            *COMMON,
            f"polishd/drivers/{self.driver}",
            f"polishd/sim_backends/{self.simulator or self.device}",
        )

    @property
    def speed(self) -> float:
        """Speed of the simulation."""
        return 2.0 if self.clock else 1.0

    @property
    def least_s(self) -> float:
        """Permitted difference between the times of a block in the journal and in the plant's account."""
        return LEAST_S if self.clock else READING_S

    def must_end(self, fault: str) -> bool:
        """Whether contact must end because of that fault."""
        return self.needed and fault in MUST_END

    def fault(self, name: str) -> dict[str, Any]:
        """Return the fault for SIM.toml, without its time."""
        fault = self.faults[name]
        of_device = {"reboot", *simulator_faults.PANEL}
        whole = not self.link or fault["what"] in of_device
        return {"device": self.device, **({} if whole else {"link": self.link}), **fault}


SILENT = {
    "robot": {"silence_s": SILENCE_S},
    "actuator": {"silence_s": SILENCE_S, "watchdog_ms": 2000},
    "spindle": {"silence_s": SILENCE_S, "watchdog_s": 3.0},
    "job": {"stream_ahead_s": 8.0},
}


def _small(folder: Path, cell: Sections | None = None, sim: Sections | None = None) -> DemoFiles:
    """Return the demo's small cell with other keys."""
    files = write_small(folder, patient=False, **ONE_PASS)
    files.cell.write_text(with_keys(with_keys(files.cell.read_text(), SILENT), cell or {}))
    files.sim.write_text(with_keys(files.sim.read_text(), sim or {}))
    return files


def _actuator(folder: Path, kind: str) -> DemoFiles:
    port = free_port()
    tcp = {"address": f"tcp://127.0.0.1:{port}"}
    cell = {"actuator": {**SILENT["actuator"], **(tcp if kind == "modbus_tcp" else {})}}
    files = _small(folder, cell)
    if kind == "serial":
        files.cell.write_text(with_values(files.cell.read_text(), {"actuator": {"type": "voice_coil_serial"}}))
        files.cell.write_text(files.cell.read_text().replace("unit = 1\n", ""))
    return files


def _spindle(folder: Path) -> DemoFiles:
    port = free_port()
    cell = {"spindle": {**SILENT["spindle"], "address": f"socketcand://127.0.0.1:{port}/can0"}}
    return _small(folder, cell)


def _cia402(folder: Path) -> DemoFiles:
    """With CiA 402 drives as actuator and spindle."""
    files = _small(folder)
    text = files.cell.read_text().replace('"spindle"', '"cia402"', 1).replace('"voice_coil", ', "", 1)
    for section, ours in (("actuator", ACTUATOR), ("spindle", SPINDLE)):
        text = re.sub(rf"^\[{section}\].*?(?=^\[)", f"{ours}\n", text, flags=re.MULTILINE | re.DOTALL)
    prompt = {"actuator": {"silence_s": SILENCE_S, "watchdog_s": 2.0, "travel_mm_s": 2.0}, "spindle": SILENT["spindle"]}
    files.cell.write_text(with_keys(text, prompt))
    return files


def _watched(folder: Path, text: str, sim: str, silent: Sections | None = None) -> DemoFiles:
    """``silent``: keys of the device that ``sim`` adds."""
    files = _small(folder)
    cell = files.cell.read_text() + text
    files.cell.write_text(with_keys(with_values(cell, {"limits": {"force_alarm_delay_s": 1.3}}), silent or {}))
    files.sim.write_text(files.sim.read_text() + sim)
    return files


def _sensed(folder: Path) -> DemoFiles:
    return _watched(folder, SENSOR.format(silence_s=SILENCE_S, delay_s=1.0), '\n[force_sensor]\nkind = "serial"\n')


def _monitored(folder: Path) -> DemoFiles:
    silent = {"monitor": {"type": "monitor_line", "address": "serial:sim/monitor", "silence_s": SILENCE_S}}
    return _watched(folder, MONITOR.format(action="lift"), '\n[monitor]\nkind = "serial"\n', silent)


def _plc(folder: Path, kind: str) -> DemoFiles:
    files = plc_robot_rig.write_files(folder, kind, 30.0, **ONE_PASS)
    profile = files.out / "controller.toml"
    profile.write_text(profile.read_text().replace("silence_s = 6.0", f"silence_s = {PLC_SILENCE_S}"))
    return files


def _hses(folder: Path) -> DemoFiles:
    files = plc_robot_rig.write_language_cell(folder, "inform over hses", "dwell", **ONE_PASS)
    profile = files.out / "controller.toml"
    profile.write_text(profile.read_text().replace("silence_s = 6.0", f"silence_s = {PLC_SILENCE_S}"))
    return files


def _universal(folder: Path) -> DemoFiles:
    files = universal_robots_rig.write_files(folder, **ONE_PASS)
    files.cell.write_text(files.cell.read_text().replace("silence_s = 3.0", f"silence_s = {SILENCE_S}"))
    return files


def _abb(folder: Path) -> DemoFiles:
    files = abb_rig.write_files(folder, **ONE_PASS)
    files.cell.write_text(files.cell.read_text().replace("silence_s = 3.0", f"silence_s = {SILENCE_S}"))
    return files


def _kuka(folder: Path) -> DemoFiles:
    files = kuka_rig.write_files(folder, **ONE_PASS)
    files.cell.write_text(files.cell.read_text().replace("silence_s = 3.0", f"silence_s = {SILENCE_S}"))
    return files


def _fanuc(folder: Path) -> DemoFiles:
    return fanuc_rmi_rig.write_files(folder, **ONE_PASS)


FORCE = {"sticks": {"what": "stick"}}
DRIFT = {"drifts": {"what": "drift", "drift_n_s": 2.0}}
CELL = {"halts": {"what": "halt"}, **DRIFT, "saturates": {"what": "saturate", "limit_n": 13.0}}
UR = partial(Link, "robot", _universal, driver="universal_robots", simulator="universal_robots")
PLC = partial(Link, "robot", silence_s=PLC_SILENCE_S, driver="plc_robot", simulator="plc_robot")
CIA402 = partial(Link, write=_cia402, driver="cia402", simulator="cia402")
ASIDE: Mapping[str, Fault] = {name: LOST[name] for name in ("hangs", "unplugged")}
LINKS: Mapping[str, Link] = {
    "robot link": Link("robot", _small, ALL, driver="robot_link"),
    "PLC robot over OPC UA": PLC(write=lambda f: _plc(f, "opcua"), faults=ALL),
    "PLC robot over ADS": PLC(write=lambda f: _plc(f, "ads"), faults={**ALL, **REFUSES}),
    "Yaskawa HSES": PLC(write=_hses, faults={**LOST, **TIMES, **DATAGRAMS, **PANEL, **KILLED}, clock=False),
    "Robot Web Services": Link("robot", _abb, ROBOT, driver="abb_rws", simulator="abb_rws"),
    "FANUC RMI": Link("robot", _fanuc, ROBOT, silence_s=FANUC_SILENCE_S, driver="fanuc_rmi", simulator="fanuc_rmi"),
    "RTDE": UR(ALL, link="rtde"),
    "dashboard": UR(ASIDE, link="dashboard", needed=False),
    "primary": UR(ASIDE, link="primary", needed=False),
    "KUKA": Link("robot", _kuka, {**ROBOT, **REFUSES}, driver="kuka_kvp", simulator="kuka_kvp"),
    "actuator, Modbus RTU": Link("actuator", _small, {**ALL, **UNIT, **REFUSES, **FORCE}),
    "actuator, Modbus TCP": Link("actuator", lambda f: _actuator(f, "modbus_tcp"), {**ALL, **UNIT, **REFUSES}),
    "actuator, lines": Link("actuator", lambda f: _actuator(f, "serial"), {**ALL, **REFUSES}),
    "actuator beside a force sensor": Link("actuator", _sensed, DRIFT),
    "spindle, slcan": Link("spindle", _small, {**ALL, **UNIT}, driver="cia402", simulator="cia402"),
    "spindle, socketcand": Link("spindle", _spindle, {**ALL, **UNIT}, driver="cia402", simulator="cia402"),
    "actuator, CiA 402": CIA402("actuator", faults={**ALL, **UNIT, **FORCE}),
    "force sensor": Link("force_sensor", _sensed, {**ALL, **REFUSES, **CELL}, driver="profile_device"),
    "monitor": Link("monitor", _monitored, {**ALL, **REFUSES}, driver="monitor_line"),
}
