"""``polishd probe`` where a wire is not as the cell says: one line, with the device, its address and what to do."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import serial

from polishd.commissioning.device_profiles import TEMPLATES
from polishd.commissioning.rehearsal.simulated_cell import with_values, write_demo
from polishd.drivers.transport.address import SerialLine
from tests.fakes.can_peers import BeatingNode, SlcanPeer, SocketcandPeer
from tests.fakes.devices_by_profile import EXAMPLES, file_of
from tests.fakes.loader import FakeLoader
from tests.fakes.peer_thread import Served
from tests.fakes.profiled import IdealDrive, ProfiledPeer, gauge, inverter
from tests.fakes.sensors_and_monitors import FakeAmplifier, FakeInputs
from tests.fakes.wires import Peer
from tests.unit.cli_result import Polishd

LOADED = [
    "rnc_robot", "devices", "voice_coil", "interferometer",
    "removal_models", "dwell_solvers", "plan_checks", "run_report",
]  # fmt: skip
LINE = SerialLine(Path(), 9600)


class Mute(Peer):
    """No device answers."""

    def on_bytes(self, data: bytes) -> None:
        pass


class Web(Peer):
    """A server of web pages, on whatever port."""

    def on_bytes(self, data: bytes) -> None:
        self.send(b"HTTP/1.1 400 Bad Request\r\n\r\n")


class DeadBus(SlcanPeer):
    """Adapter that accepts commands and receives nothing."""

    def __init__(self) -> None:
        node = BeatingNode()
        super().__init__(node)
        node.stop()

    def on_bytes(self, data: bytes) -> None:
        self.send(b"\r" * data.count(b"\r"))


def profiled(name: str, *, tcp: bool = False) -> Callable[[], Peer]:
    machine = {"voice_coil_modbus": IdealDrive, "voice_coil_serial": IdealDrive, "line_drive.toml": IdealDrive}
    return lambda: ProfiledPeer(file_of(name), machine.get(name, inverter), tcp=tcp)


def on_can(node: int, host: type[SlcanPeer | SocketcandPeer] = SlcanPeer) -> Callable[[], Peer]:
    return lambda: host(BeatingNode(node))


SPINDLE = '[spindle]\ntype = "spindle_profile"\nprofile = "delta_ms300"'
ACTUATOR = '[actuator]\ntype = "actuator_profile"\nwatchdog_s = 1.0\nprofile'
LINES = f'{ACTUATOR} = "{file_of("line_drive.toml")}"'
MODBUS, NUMBERED = f'{ACTUATOR} = "voice_coil_modbus"', f'{ACTUATOR} = "voice_coil_serial"'
LOADER, MONITOR = '[loader]\ntype = "loader_line"', '[monitor]\ntype = "monitor_line"'
SENSOR = '[force_sensor]\ntype = "force_sensor_profile"\nprofile = "force_sensor_line"'
CIA402 = f'[spindle]\ntype = "cia402_spindle"\neds = "{EXAMPLES / "drive.eds"}"\nrpm_per_unit = 0.1\nnode = 5'

NO_ANSWER = r"within [\d.]+ s at 9600 8N1"
SILENT = r"within [\d.]+ s"
OTHER = "is it another device?"
BUSY, NO_WAY = "another program has the port open", "no permission to open the port"
GONE = "the port does not exist"


@dataclass(frozen=True)
class Case:
    """A device section, what is at the other end, and its message."""

    kind: str
    what: str
    section: str
    peer: Callable[[], Peer]
    says: str
    true: SerialLine = LINE
    """What the device is set to."""

    @property
    def wire(self) -> str:
        return "can" if self.section == CIA402 else "stream"


WRONG = {
    "too fast": replace(LINE, baud=4800),
    "too slow": replace(LINE, baud=19_200),
    "parity": replace(LINE, parity="even"),
}


def wrong_lines() -> Iterator[Case]:
    for what, true in WRONG.items():
        yield Case("rtu", what, SPINDLE, profiled("delta_ms300"), rf"unit 1: no answer {NO_ANSWER}", true)
        yield Case("lines", what, LINES, profiled("line_drive.toml"), rf"no answer to '\?' {NO_ANSWER}", true)
        yield Case("loader", what, LOADER, FakeLoader, rf"no answer to ST\? {NO_ANSWER}", true)
        yield Case("sensor", what, SENSOR, FakeAmplifier, rf"no answer to F\? {NO_ANSWER}", true)
        yield Case("monitor", what, MONITOR, FakeInputs, rf"no answer to ID\? {NO_ANSWER}", true)
        yield Case("cia402", what, CIA402, on_can(5), "and the adapter's 9600 baud", true)


INVERTER, COIL, DRIVE = profiled("delta_ms300"), profiled("voice_coil_modbus", tcp=True), profiled("line_drive.toml")
CASES = [
    *wrong_lines(),
    Case("rtu", "unit", f"{SPINDLE}\nunit = 7", INVERTER, rf"unit 7: no answer {NO_ANSWER}.* unit number"),
    Case("rtu", "profile", MODBUS, INVERTER, f"unit 1: exception 2, address not known; {OTHER}"),
    Case("rtu", "lines there", MODBUS, DRIVE, f"unit 1: no answer {NO_ANSWER}"),
    Case("lines", "numbered there", NUMBERED, DRIVE, r"ST\?: '!.*' within .* is not an"),
    Case("lines", "prose", LINES, Web, rf"\? was answered by 'HTTP.*'.*; {OTHER}"),
    Case("loader", "a sensor there", LOADER, FakeAmplifier, rf"ST\? was refused: unknown.*; {OTHER}"),
    Case("sensor", "a loader there", SENSOR, FakeLoader, rf"F\? was refused: unknown.*; {OTHER}"),
    Case("monitor", "a loader there", MONITOR, FakeLoader, rf"LS\?,0 was refused: unknown.*; {OTHER}"),
    Case("cia402", "node", CIA402, on_can(9), "node 5: .*; only nodes 9 send"),
    Case("cia402", "bit rate", CIA402, DeadBus, "the bus is silent"),
]  # fmt: skip
TCP = [
    Case("modbus tcp", "unit", f"{MODBUS}\nunit = 3", COIL, f"unit 3: .*{SILENT}.* unit number"),
    Case("modbus tcp", "a web server", MODBUS, Web, "the answer is not Modbus TCP"),
    Case("modbus tcp", "lines there", MODBUS, DRIVE, f"no answer {SILENT}"),
    Case("lines tcp", "Modbus there", LINES, COIL, rf"no answer to '\?' {SILENT}"),
    Case("loader tcp", "mute", LOADER, Mute, rf"no answer to ST\? {SILENT}"),
    Case("sensor tcp", "a web server", SENSOR, Web, r"F\?: 'HTTP.*' within .* is not an"),
    Case("socketcand", "node", CIA402, on_can(9, SocketcandPeer), "node 5: .*; only nodes 9 send"),
    Case("socketcand", "mute", CIA402, Mute, "no greeting within 1 s; is it a socketcand server"),
]  # fmt: skip


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell whose sections are replaced."""
    cell = write_demo(tmp_path_factory.mktemp("demo") / "out", None, 2.0, 4, None).cell
    text = with_values(cell.read_text(), {"plugins": {"load": "?"}})
    cell.write_text(text.replace('load = "?"', f"load = {json.dumps(LOADED)}"))
    return cell


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    served = Served(tmp_path)
    yield served
    served.close()


@dataclass(frozen=True)
class Asked:
    """``probe`` of a cell with one changed section."""

    polishd: Polishd
    cell: Path

    def shown(self, section: str, address: str) -> str:
        """What is wrong, which must be one line that names role and address, and the same for programs."""
        role = section[1:].partition("]")[0]
        rest = re.sub(rf"^\[{role}\].*\n(?:(?!\[).*\n)*", "", self.cell.read_text(), flags=re.MULTILINE)
        path = self.cell.with_name("probed.toml")
        path.write_text(f'{rest}\n{section}\naddress = "{address}"\n')
        people, program = (self.polishd("probe", path, "--only", role, *more) for more in ((), ("--json",)))
        assert (people.code, program.code) == (5, 5), people
        assert people.err == f"polishd: 1 of 1 devices failed: {role}. See the table above\n"
        (line,) = (line for line in people.out.splitlines() if line.startswith(f"{role}: "))
        said = line.removeprefix(f"{role}: ")
        assert said.startswith(address.partition("?")[0])
        assert len(said) < 250, said
        shown: dict[str, dict[str, str]] = json.loads(program.out)
        assert re.sub(r"\d+ bytes", "", shown[role]["error"]) == re.sub(r"\d+ bytes", "", said)
        return said


@pytest.fixture
def asked(polishd: Polishd, demo: Path) -> Asked:
    return Asked(polishd, demo)


@pytest.mark.full
@pytest.mark.one_of_each("case.wire")
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.kind}-{case.what}")
def test_a_wrong_serial_line_is_reported_in_one_line(asked: Asked, served: Served, case: Case) -> None:
    path = served.serial(case.peer, LINE, case.true)
    scheme = f"slcan:{path}?baud=9600" if case.wire == "can" else f"serial:{path}?baud=9600"
    assert re.search(case.says, asked.shown(case.section, scheme))


@pytest.mark.full
@pytest.mark.one_of_each("case.wire")
@pytest.mark.parametrize("case", TCP, ids=lambda case: f"{case.kind}-{case.what}")
def test_a_wrong_peer_on_tcp_is_reported_in_one_line(asked: Asked, served: Served, case: Case) -> None:
    where = f"127.0.0.1:{served.tcp(case.peer)}"
    address = f"socketcand://{where}/can0" if case.wire == "can" else f"tcp://{where}"
    assert re.search(case.says, asked.shown(case.section, address))


@pytest.mark.parametrize(
    "section",
    [CIA402, *(pytest.param(one, marks=pytest.mark.full) for one in (SPINDLE, LINES, LOADER))],
    ids=["slcan", "rtu", "lines", "loader"],
)
def test_a_port_that_does_not_open_is_reported_in_one_line(
    asked: Asked, served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, section: str
) -> None:
    scheme = "slcan" if section == CIA402 else "serial"
    path = served.serial(Mute, LINE, LINE)
    with serial.Serial(str(path), exclusive=True):
        assert BUSY in asked.shown(section, f"{scheme}:{path}")
    assert GONE in asked.shown(section, f"{scheme}:{tmp_path / 'none'}")
    assert "it is not a serial port" in asked.shown(section, f"{scheme}:{asked.cell}")
    opened = os.open

    def forbidden(name: str, *how: int, **more: int) -> int:
        if name == str(path):
            raise PermissionError(13, "Permission denied", name)
        return opened(name, *how, **more)

    monkeypatch.setattr(os, "open", forbidden)
    assert NO_WAY in asked.shown(section, f"{scheme}:{path}")


def test_the_wrong_word_order_is_reported_in_one_line(asked: Asked, served: Served, tmp_path: Path) -> None:
    template = (TEMPLATES / "force_sensor_modbus.toml").read_text()
    true, wrong = tmp_path / "true.toml", tmp_path / "wrong.toml"
    true.write_text(template.replace('"i32"', '"f32"').replace("scale = 0.01", ""))
    wrong.write_text(true.read_text().replace('word_order = "high_first"', 'word_order = "low_first"'))
    port = served.tcp(lambda: ProfiledPeer(true, gauge(lambda: 12.34), tcp=True))
    section = f'[force_sensor]\ntype = "force_sensor_profile"\nprofile = "{wrong}"'
    said = asked.shown(section, f"tcp://127.0.0.1:{port}")
    assert said.endswith("see word order, scale and whether it is this device")


def test_what_is_set_right_answers(polishd: Polishd, served: Served, demo: Path) -> None:
    """The receiver of the fakes is none that only garbles."""
    line = SerialLine(Path(), 4800, "even", 2)
    path = served.serial(profiled("line_drive.toml"), line, replace(line))
    text = re.sub(r"^\[actuator\].*\n(?:(?!\[).*\n)*", "", demo.read_text(), flags=re.MULTILINE)
    cell = demo.with_name("right.toml")
    cell.write_text(f'{text}\n{LINES}\naddress = "serial:{path}?baud=4800&parity=even&stop_bits=2"\n')
    assert polishd("probe", cell, "--only", "actuator", "--json").answer["actuator"]["model"] == "line drive"
