"""The device type ``plc_robot``: what its options name is looked at before anything is opened."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import pytest

from polishd.api import ConfigError, DeviceContext, OwnLines, Robot
from polishd.commissioning.rehearsal.simulated_cell import demo_program, with_values
from polishd.config.cell import load_config
from polishd.config.controller_profile import shipped
from polishd.daemon import checks
from polishd.daemon.assembly import require_accepted_by_robot
from polishd.drivers.plc_robot.device_types import PlcRobotOptions, build, own_lines
from polishd.model.errors import PolishdError
from polishd.plugin_loader import load_own
from polishd.plugins.rnc_robot.dialect import DIALECTS
from tests.commissioned import commissioned

OPCUA = {"profile": "plc-opcua", "address": "opc.tcp://127.0.0.1:4840", "delivery": "folder:nc"}
ADS = {**OPCUA, "profile": "plc-ads", "address": "ads://plc.local/5.1.2.3.1.1:851"}
HSES = {**OPCUA, "profile": "yaskawa-hses", "address": "hses://10.0.0.2:10040"}
MODBUS = {**OPCUA, "profile": "plc-modbus", "address": "tcp://127.0.0.1:502"}
FTP = {**OPCUA, "delivery": "ftp://robot@127.0.0.1/nc", "delivery_password": "file:password"}


def built(folder: Path, **options: Any) -> Robot:
    (folder / "password").write_text("s3cret\n")
    (folder / "password").chmod(0o600)
    (folder / "hosts").touch()
    context = DeviceContext(base_dir=folder, state_dir=folder / "state", part_id="P-1", readers=())
    return build(PlcRobotOptions(**options), context)


@pytest.mark.parametrize(
    "options",
    [
        OPCUA,
        {**OPCUA, "user": "me", "password": "file:password"},
        ADS,
        MODBUS,
        HSES,
        FTP,
        {**FTP, "delivery": "sftp://robot@127.0.0.1:2222/nc", "known_hosts": "hosts"},
    ],
)
def test_robots_are_built_closed(tmp_path: Path, options: dict[str, str]) -> None:
    assert isinstance(built(tmp_path, **options), Robot)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({**OPCUA, "profile": "plc"}, "profile 'plc' is not known"),
        ({**OPCUA, "address": "tcp://a:1"}, r"address 'tcp://a:1': opcua needs opc\.tcp://host:port"),
        ({**ADS, "address": "ads://plc:851"}, r"address 'ads://plc:851': write ads://host/NETID:PORT"),
        ({**ADS, "address": "ads://plc/5.1.2.300.1.1:851"}, "write ads:"),
        ({**HSES, "address": "udp://a:10040"}, r"address 'udp://a:10040': write hses://host:10040"),
        ({**HSES, "address": "hses://a:99999"}, r"address 'hses://a:99999': write hses://host:10040"),
        ({**ADS, "address": "ads://plc/5.1.2.3.1.1:70000"}, "write ads:"),
        ({**MODBUS, "address": "serial:/dev/ttyS0"}, r"modbus runs over tcp://"),
        ({**OPCUA, "delivery": "nfs:x"}, "delivery 'nfs:x': write folder:PATH"),
        ({**OPCUA, "delivery": "ftp://host/nc"}, "write ftp://user@host/PATH"),
        ({**OPCUA, "delivery": "ftp://user:secret@host/nc"}, "its password is delivery_password"),
        ({**FTP, "delivery": "sftp://robot@host/nc", "known_hosts": "none"}, "known_hosts 'none' is not a file"),
        ({**FTP, "delivery_password": "file:other"}, "cannot be read"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, options: dict[str, str], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        built(tmp_path, **options)


@pytest.mark.parametrize(
    ("options", "library", "extra"), [(OPCUA, "asyncua", "opcua"), (ADS, "pyads", "ads"), (FTP, "aioftp", "ftp")]
)
def test_a_library_that_is_missing_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: dict[str, str], library: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ConfigError, match=rf"needs {library}, .* pip install 'polishd\[{extra}\]'"):
        built(tmp_path, **options)


def cell(tmp_path: Path, example: str, *, wired: bool = False, max_stall_removal_nm: float = 10.0) -> Path:
    """The shipped example with such a robot."""
    commissioned(tmp_path)
    section, _, _ = example.partition("[robot]")[2].partition("\n[")
    robot = (
        '\ntype = "plc_robot"\nprofile = "mine.toml"\naddress = "opc.tcp://127.0.0.1:4840"\ndelivery = "folder:nc"\n'
    )
    text = example.replace(section, robot)
    text = text.replace("force_band = 0.25", f"max_stall_removal_nm = {max_stall_removal_nm}\nforce_band = 0.25")
    shipped = Path(checks.__file__).parents[1] / "config" / "controller_profiles" / "plc-opcua.toml"
    profile = shipped.read_text().replace("report_ms = 20.0", "report_ms = 230.0")
    (tmp_path / "mine.toml").write_text(("in_motion_wired = true\n" if wired else "") + profile)
    path = tmp_path / "cell.toml"
    path.write_text(with_values(text, {"instrument": {"profile": "instrument.toml"}, "part": {"aperture_mm": 20.0}}))
    config = load_config(path)
    config.program_path.write_bytes(demo_program(config))
    return path


def checked(path: Path) -> dict[str, Any]:
    return checks.check_cell(load_config(path), load_own())


def test_a_feed_hold_that_would_dig_is_refused_by_check(tmp_path: Path, example: str) -> None:
    """230 ms to the report, 115 ms to the look, 20 ms on the link, 200 ms until the force is off: some 90 nm."""
    with pytest.raises(
        ConfigError, match=r"cell\.toml:\d+: limits\.max_stall_removal_nm: a feed hold .* would dig \d+\.\d nm"
    ) as said:
        checked(cell(tmp_path, example))
    assert "365 ms" in str(said.value)
    assert "in_motion_wired" in str(said.value)


@pytest.mark.full
def test_a_wire_to_the_actuator_makes_up_for_slow_reports(tmp_path: Path, example: str) -> None:
    assert "feed hold at the controller" not in checked(cell(tmp_path, example, wired=True))
    found = checked(cell(tmp_path, example, max_stall_removal_nm=100.0))
    assert "nm at most" in found["feed hold at the controller"]
    assert "end of a block known to" not in found, "its controller reports when each began"
    path = cell(tmp_path, example, max_stall_removal_nm=100.0)
    profile = (tmp_path / "mine.toml").read_text().replace("line_began =", "# ")
    (tmp_path / "mine.toml").write_text(profile)
    assert "66 ms rms, 1" in checked(path)["end of a block known to"]


@pytest.mark.parametrize(
    ("profile", "is_taken"), [("staubli-val3", False), ("yaskawa-inform", False), ("plc-opcua", True)]
)
def test_lines_of_a_language_go_with_its_programs_only(
    tmp_path: Path, example: str, profile: str, is_taken: bool
) -> None:
    path = cell(tmp_path, example, max_stall_removal_nm=200.0)
    path.write_text(path.read_text().replace('"mine.toml"', f'"{profile}"'))
    config, hooks = load_config(path), load_own()
    program = hooks.program_formats()["rs274"].read(config.program_path.read_bytes(), "program.rnc")
    if is_taken:
        require_accepted_by_robot(config, hooks, program)
        return
    with pytest.raises(ConfigError, match=r"program\.format: 'rs274' does not go with .*(lines of 'val3'|TIMER)"):
        require_accepted_by_robot(config, hooks, program)


FITTING = {
    "plc-ads": {"rs274", "haas", "grbl"},
    "plc-modbus": {"rs274", "haas", "grbl"},
    "plc-opcua": {"rs274", "haas", "grbl"},
    "sinumerik-opcua": {"siemens", "twincat-nci"},
    "twincat-nci": {"twincat-nci", "twincat-cnc", "fanuc", "siemens-iso"},
    "staubli-val3": set(),  # its lines call programs of the controller
    "yaskawa-inform": {"inform"},
    "yaskawa-hses": {"inform"},
}
"""Dialects in which the lines of a shipped profile are what they are meant to be."""


def test_dialects_and_controller_profiles_are_held_against_each_other(tmp_path: Path) -> None:
    formats = load_own().program_formats()
    context = DeviceContext(tmp_path, tmp_path, "P-1", ())
    found: dict[str, set[str]] = {}
    for profile in shipped():
        lines = own_lines(PlcRobotOptions(**{**OPCUA, "profile": profile}), context)
        said = {name: known.misreads(lines) for name, known in formats.items() if known.misreads is not None}
        assert set(said) == set(DIALECTS)
        found[profile] = {name for name, wrong in said.items() if not wrong}
        assert all("is no dwell in" in wrong for wrong in said.values() if wrong)
    assert found == FITTING


@pytest.mark.parametrize(
    ("name", "dwell", "stops", "said"),
    [
        ("rapid", "WaitTime {:.3f};", ("Stop;", ""), ""),
        ("rapid", "WaitTime {:.3f};", ("M0", ""), "'M0' is G-code, and rapid is none"),
        ("rapid", "WaitTime {:.3f};", ("Stop;", "M2"), "'M2' is G-code, and rapid is none"),
        ("krl", "WAIT SEC {:.3f}", ("HALT", ""), ""),
        ("krl", "WaitTime {:.3f};", ("HALT", ""), "'WaitTime 0.250;' is no dwell in krl"),
        ("weihong", "G4 P{:.0f}", ("M0", "M30"), r"'G4 P2' rests for 0\.002 s in weihong, not for 2 s"),
        ("siemens", "N7 G04 F{:.3f} ; ours", ("N8 M0 ; ours", "M30"), ""),
        ("siemens", "G4 F{:.3f}", ("M0 (ours)", "M30"), r"'M0 \(ours\)' is no stop and no end of a program in siemens"),
        ("rs274", "G1 P{:.3f}", ("M0", "M2"), "is no dwell in rs274"),
        ("rs274", "G4 P{:.3f} X1", ("M0", "M2"), "is no dwell in rs274"),
        ("rs274", "G4 P{:.3f}", ("HALT", "M2"), "'HALT' is no stop and no end of a program in rs274"),
    ],
)
def test_lines_of_a_profile_of_ones_own_are_read_as_the_dialect_reads_them(
    name: str, dwell: str, stops: tuple[str, ...], said: str
) -> None:
    times = (2.0, 3.0) if ":.0f" in dwell else (0.25, 2.5)
    known = load_own().program_formats()[name]
    assert known.misreads is not None
    wrong = known.misreads(OwnLines("a profile", {seconds: dwell.format(seconds) for seconds in times}, stops))
    assert re.search(said, wrong) if said else wrong == ""


RAPID = r"""MODULE raster
  PROC raster()
    MoveL [[0,0,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v10,fine,tool0;
    WaitTime 0.5;
    MoveL [[1,0,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v10,fine,tool0;
    WaitTime 0.5;
  ENDPROC
ENDMODULE
"""


def test_check_refuses_a_program_in_another_language_than_its_controller_profile(tmp_path: Path, example: str) -> None:
    path = cell(tmp_path, example, wired=True)
    (tmp_path / "raster.mod").write_text(RAPID)
    text = re.sub(r"^\[touch_off\].*\n(?:(?!^\[).*\n)*", "", path.read_text(), flags=re.MULTILINE)
    path.write_text(with_values(text, {"program": {"format": "rapid", "path": "raster.mod"}}))
    with pytest.raises(
        ConfigError, match=r"cell\.toml:\d+: program\.format: 'rapid' does not go with \[program\] of"
    ) as error:
        checked(path)
    assert "'G4 P0.250 (polishd)' is no dwell in rapid" in str(error.value)
    profile = (tmp_path / "mine.toml").read_text()
    for before, after in (("M0 (polishd)", "Stop;"), ("G4 P{seconds:.3f} (polishd)", "WaitTime {seconds:.3f};")):
        profile = profile.replace(before, after)
    (tmp_path / "mine.toml").write_text(profile.replace("[program]", '[program]\nend = ""'))
    with pytest.raises(PolishdError) as other:  # the two points are no pass over this part
        checked(path)
    assert "program.format" not in str(other.value)
