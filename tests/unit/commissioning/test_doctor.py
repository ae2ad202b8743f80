"""``polishd doctor``: each check finds what it looks for, and says what to run."""

from __future__ import annotations

import json
import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from polishd.cli.app import app
from polishd.commissioning import doctor
from polishd.commissioning.doctor import DoctorRow
from polishd.daemon.runtime.process import PriorityResult

EXAMPLE = Path(__file__).parents[3] / "examples" / "cell.toml"
REQUIRES = ["numpy<3,>=2.2", "old>=2", "none>=1; sys_platform == 'none'", "astropy>=7; extra == 'fits'",
            "pyads>=3; extra == 'ads'"]  # fmt: skip
INSTALLED = {"numpy": "2.4.1", "old": "1.9", "astropy": "8.0"}


def states(rows: Iterator[DoctorRow] | list[DoctorRow]) -> dict[str, str]:
    return {row.check: row.state for row in rows}


def test_a_dependency_of_another_version_is_a_problem_with_its_command() -> None:
    (row,) = doctor.dependency_rows(REQUIRES, INSTALLED.get)
    assert (row.check, row.state, row.found) == ("dependency old", "problem", "1.9 does not fit >=2")
    assert row.todo == "Run: pip install 'old>=2'"
    (missing,) = doctor.dependency_rows(["gone<2"], INSTALLED.get)
    assert (missing.found, missing.todo) == ("not installed", "Run: pip install 'gone<2'")
    assert states(doctor.dependency_rows(REQUIRES[:1], INSTALLED.get)) == {"dependencies": "ok"}


def test_an_extra_is_a_problem_only_if_the_cell_needs_it() -> None:
    rows = {row.check: row for row in doctor.extra_rows(REQUIRES, INSTALLED.get)}
    assert rows["extra fits"].found == "astropy 8.0"
    assert (rows["extra ads"].state, "pip install 'polishd[ads]'" in rows["extra ads"].todo) == ("ok", True)
    assert states(doctor.extra_rows(REQUIRES, INSTALLED.get, {"ads"}))["extra ads"] == "problem"


def test_the_own_installation_is_whole() -> None:
    rows = {row.check: row for row in doctor.examine(None)}
    assert rows["dependencies"].state == "ok"
    assert "extra opcua" in rows
    assert "extra all" not in rows


def test_a_python_newer_than_the_tested_ones_is_a_warning() -> None:
    python = "Programming Language :: Python :: "
    this = f"{python}{sys.version_info.major}.{sys.version_info.minor}"
    assert states(doctor.software_rows(">=3.11", [f"{python}3 :: Only", f"{python}3.9", this]))["Python"] == "ok"
    (row, _) = doctor.software_rows(">=3.9", [f"{python}3 :: Only", f"{python}3.9", f"{python}3.10"])
    assert (row.state, row.todo) == ("warning", "Use Python 3.10")


def test_serial_ports_need_their_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    assert doctor.serial_row([str(port)], []).state == "ok"
    monkeypatch.setattr(os, "access", lambda *_: False)
    closed = doctor.serial_row([str(port)], [])
    assert (closed.state, "usermod -aG" in closed.todo) == ("warning", True)
    monkeypatch.setattr(os, "getuid", lambda: 1000)
    without = doctor.serial_row([], [])
    assert (without.state, "dialout" in without.todo) == ("warning", True)
    assert doctor.serial_row([], [doctor.grp.getgrnam("dialout").gr_gid]).state == "ok"


def test_a_can_interface_that_is_down_is_a_warning(tmp_path: Path) -> None:
    assert doctor.can_row(tmp_path).state == "ok"
    for name, kind, flags in (("eth0", "1", "0x1003"), ("can0", "280", "0x40c1")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "type").write_text(f"{kind}\n")
        (tmp_path / name / "flags").write_text(f"{flags}\n")
    assert doctor.can_row(tmp_path) == DoctorRow("CAN", "ok", "can0: up; socketcand serves them")
    (tmp_path / "can0" / "flags").write_text("0x40c0\n")
    down = doctor.can_row(tmp_path)
    assert (down.state, "ip link set can0 up" in down.todo) == ("warning", True)


@pytest.mark.parametrize("allowed", [True, False])
def test_priority_and_memory_lock(*, allowed: bool) -> None:
    rows = list(doctor.priority_rows(PriorityResult(first=allowed, locked=allowed, cores=2)))
    assert {row.state for row in rows} == {"ok" if allowed else "warning"}
    assert all(bool(row.todo) is not allowed for row in rows)


def test_systemd_of_the_system_and_of_a_user(tmp_path: Path) -> None:
    assert states(doctor.systemd_rows(tmp_path, 1000, "ann")) == {"systemd": "warning"}
    (tmp_path / "run/systemd/system").mkdir(parents=True)
    assert states(doctor.systemd_rows(tmp_path, 0, "root")) == {"systemd": "ok"}
    assert states(doctor.systemd_rows(tmp_path, 1000, "ann"))["systemd, user"] == "warning"
    (tmp_path / "run/user/1000/systemd").mkdir(parents=True)
    assert [row.todo for row in doctor.systemd_rows(tmp_path, 1000, "ann")][1] == "Run: sudo loginctl enable-linger ann"
    (tmp_path / "var/lib/systemd/linger").mkdir(parents=True)
    (tmp_path / "var/lib/systemd/linger/ann").touch()
    assert states(doctor.systemd_rows(tmp_path, 1000, "ann"))["systemd, user"] == "ok"


@pytest.mark.parametrize(("state", "found"), [(0, "ok"), (5, "warning"), (-1, "ok")])
def test_the_clock(state: int, found: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_adjtimex", lambda: state)
    rows = states(doctor.clock_rows())
    assert (rows["clock"], rows["monotonic clock"], rows["time zone"]) == (found, "ok", "ok")
    monkeypatch.setattr(doctor, "COARSEST_S", 0.0)
    assert states(doctor.clock_rows())["monotonic clock"] == "problem"


def test_the_kernel_tells_whether_its_clock_is_synchronized() -> None:
    assert doctor._adjtimex() in range(-1, 6)


def test_disks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert states(doctor.disk_rows(tmp_path / "state", tmp_path / "state")) == {"state folder": "ok"}
    assert states(doctor.disk_rows(tmp_path / "state", tmp_path)) == {"state folder": "ok", "run folder": "ok"}
    real, access = os.statvfs(tmp_path), os.access
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert "chown" in next(doctor.disk_rows(tmp_path, tmp_path)).todo
    monkeypatch.setattr(os, "access", access)
    for field, word in ((4, "Make room: 128 MB"), (7, "Delete files: 256")):  # f_bavail, f_favail
        changed = [*real]
        changed[field] = 3
        monkeypatch.setattr(os, "statvfs", lambda _, changed=changed: os.statvfs_result(changed))
        (row,) = doctor.disk_rows(tmp_path, tmp_path)
        assert (row.state, row.exit_code, word in row.todo) == ("problem", 5, True)


@pytest.mark.parametrize(
    ("address", "state", "found"),
    [
        ("serial:gone?baud=9600", "problem", "there is no"),
        ("slcan:file?bitrate=500000", "problem", "is no port"),
        ("serial:port", "ok", "the port is there"),
        ("serial:port?baud=fast", "problem", "baud"),
        ("tcp://127.0.0.1:28500", "ok", "not connected"),
        ("socketcand://127.0.0.1:29536/can0", "ok", "not connected"),
        ("opc.tcp://127.0.0.1:4840", "ok", "not connected"),
        ("ads://127.0.0.1/1.2.3.4.5.6:851", "ok", "not connected"),
        ("tcp://host.invalid:1", "problem", "has no address"),
    ],
)
def test_addresses(address: str, state: str, found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    controller, port = os.openpty()
    (tmp_path / "port").symlink_to(os.ttyname(port))
    resolve = socket.getaddrinfo

    def known(host: str, *more: object, **how: object) -> object:
        if host.endswith(".invalid"):
            raise socket.gaierror(-2, "Name or service not known")
        return resolve(host, *more, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(socket, "getaddrinfo", known)
    row = doctor.address_row("robot", address, tmp_path)
    os.close(controller)
    os.close(port)
    assert (row.state, found in row.found, bool(row.todo)) == (state, True, state == "problem")


# The command.


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    for name in ("cell.toml", "instrument.toml"):
        (tmp_path / name).write_text((EXAMPLE.parent / name).read_text(encoding="utf-8"), encoding="utf-8")
    return tmp_path / "cell.toml"


@pytest.mark.full
def test_the_devices_of_a_cell(cell: Path) -> None:
    result = CliRunner().invoke(app, ["doctor", str(cell), "--json"])
    answer = json.loads(result.output)
    found = {one["check"]: one for one in answer["checks"]}
    assert (result.exit_code, answer["exit_code"], answer["counts"]["problem"]) == (5, 5, 3)
    assert {name: found[name]["state"] for name in ("cell", "robot", "actuator", "spindle", "metrology")} == {
        "cell": "ok", "robot": "ok", "actuator": "problem", "spindle": "problem", "metrology": "problem",
    }  # fmt: skip
    (cell.parent / "sim" / "maps").mkdir(parents=True)
    again = json.loads(CliRunner().invoke(app, ["doctor", str(cell), "--json"]).output)
    assert again["counts"]["problem"] == 2


@pytest.mark.full
def test_it_connects_to_no_device(cell: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as robot:
        robot.setblocking(False)
        text = cell.read_text(encoding="utf-8").replace(":28500", f":{robot.getsockname()[1]}")
        cell.write_text(text, encoding="utf-8")
        assert "robot" in {row.check for row in doctor.examine(cell)}
        with pytest.raises(BlockingIOError):
            robot.accept()


@pytest.mark.full
def test_a_plugin_that_cannot_be_loaded_is_a_problem(cell: Path) -> None:
    cell.write_text(
        cell.read_text(encoding="utf-8").replace('"run_report"]', '"run_report", "gone"]'), encoding="utf-8"
    )
    rows = [row for row in doctor.examine(cell) if row.state == "problem" and "gone" in row.check + row.found]
    assert [row.exit_code for row in rows] == [3]


def test_each_problem_and_warning_says_what_to_do(cell: Path) -> None:
    for row in doctor.examine(cell):
        assert row.todo or row.state == "ok", row


def test_a_wrong_cell_is_a_row_and_the_others_are_there(cell: Path) -> None:
    cell.write_text(cell.read_text(encoding="utf-8").replace("[spindle]", "[spinel]"), encoding="utf-8")
    result = CliRunner().invoke(app, ["doctor", str(cell), "--json"])
    found = {one["check"]: one for one in json.loads(result.output)["checks"]}
    assert (result.exit_code, found["cell"]["state"], found["dependencies"]["state"]) == (3, "problem", "ok")
    assert "spin" in found["cell"]["found"]
    assert found["cell"]["todo"]


def test_without_problems_it_names_the_next_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "examine", lambda _: [DoctorRow("a", "ok", "b"), DoctorRow("c", "warning", "d", "e")])
    result = CliRunner().invoke(app, ["doctor"])
    assert (result.exit_code, "1 ok, 1 warning, 0 problem. Next: polishd doctor CELL.toml" in result.output) == (
        0,
        True,
    )
