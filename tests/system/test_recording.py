"""The traffic of a cell's wires is recorded, and the devices' side is replayed for the current drivers."""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from polishd.api import LinkError
from polishd.commissioning.rehearsal.simulated_cell import simulated_cell
from polishd.drivers.cia402.device_types import SIMULATED_EDS
from polishd.interfaces import Device
from polishd.model.devices import DeviceIdentity
from polishd.model.errors import ConfigError
from polishd.plugins import devices, voice_coil
from polishd.testing.device_rig import DriverCase
from polishd.testing.replay import replayed
from polishd.util.wire_recording import read_recording
from tests.system.cell_rig import PATIENT, write_small
from tests.time_limits import SOON_S

pytestmark = [pytest.mark.system]

ACTUATOR, SPINDLE = ({"address": "{endpoint}", **PATIENT[role]} for role in ("actuator", "spindle"))
"""Part id of the cell file."""


@pytest.fixture(scope="module")
def probed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Record a probe of a simulated cell; return the recording and the probe's report."""
    files = write_small(tmp_path_factory.mktemp("cell") / "cell")
    case = files.cell.parent / "case.wire.jsonl.gz"
    with simulated_cell(files.sim, ["--state", str(files.sim_dir), "--seed", "3"], files.cell.parent / "sim.stderr"):
        said = polishd("probe", files.cell, "--json", "--record", case)
    return case, json.loads(said)


def polishd(*arguments: object) -> str:
    command = [sys.executable, "-m", "polishd.cli.app", *map(str, arguments)]
    said = subprocess.run(command, capture_output=True, text=True, timeout=SOON_S, check=False)
    assert said.returncode == 0, said.stderr
    return said.stdout


def driver(plugin: Any, kind: str, options: dict[str, Any], folder: Path, endpoint: str) -> Device:
    return DriverCase(plugin=plugin, type=kind, options=options).build(folder, endpoint)


@pytest.mark.full
async def test_a_recorded_probe_is_played_to_the_drivers(
    probed: tuple[Path, dict[str, Any]], tmp_path: Path, type_of_actuator: str
) -> None:
    case, said = probed
    for role, plugin, kind, options in (
        ("actuator", voice_coil, type_of_actuator, ACTUATOR),
        ("spindle", devices, "cia402_spindle", {**SPINDLE, "eds": str(SIMULATED_EDS), "node": 5, "rpm_per_unit": 0.1}),
    ):
        async with replayed(case, role) as link:
            device = driver(plugin, kind, options, tmp_path, link.endpoint)
            await device.open()
            identity: DeviceIdentity = await device.identify()
            await device.make_safe()
            status = await device.status()
            await device.close()
        assert (identity.model, identity.serial) == (said[role]["model"], said[role]["serial"])
        assert (status.ready, status.safe) == (True, True)


@pytest.fixture
def type_of_actuator(probed: tuple[Path, dict[str, Any]]) -> str:
    return str(read_recording(probed[0]).header["devices"]["actuator"]["type"])


@pytest.mark.full
def test_the_file_names_devices_links_and_ends(probed: tuple[Path, dict[str, Any]]) -> None:
    found = read_recording(probed[0])
    assert found.header["cell"]
    assert {one.role for one in found.passed} == {"actuator", "robot", "spindle"}
    assert found.notes == ()
    for role in ("actuator", "robot", "spindle"):
        ways = [one.way for _, one in found.of(role)]
        assert ways[0] == "open"
        assert ways[-1] == "end"
        assert {"out", "in"} <= set(ways)
    assert all(one.identifier is not None for _, one in found.of("spindle") if one.way in ("out", "in"))
    times = [one.at_s for one in found.passed]
    assert times == sorted(times)


@pytest.mark.full
def test_the_links_are_shown(probed: tuple[Path, dict[str, Any]]) -> None:
    shown = json.loads(polishd("recording", "show", probed[0], "--json"))
    links = {link["device"]: link for link in shown["links"]}
    assert set(links) == {"actuator", "robot", "spindle"}
    assert shown["missing"] == []
    for link in links.values():
        assert link["out"] <= link["bytes_out"]
        assert 0 < link["in"] <= link["bytes_in"]
        assert 0.0 <= link["first_s"] <= link["first_s"] + link["longest_silence_s"] <= link["last_s"]
    assert "spindle" in polishd("recording", "show", probed[0])


def mutilated(case: Path, folder: Path, change: Callable[[list[bytes]], list[bytes]]) -> Path:
    path = folder / "changed.jsonl"
    path.write_bytes(b"".join(change(gzip.decompress(case.read_bytes()).splitlines(keepends=True))))
    return path


@pytest.mark.full
async def test_what_is_not_recorded_is_said(
    probed: tuple[Path, dict[str, Any]], tmp_path: Path, type_of_actuator: str
) -> None:
    def no_answer_fits(lines: list[bytes]) -> list[bytes]:
        rows = [json.loads(line) for line in lines]
        for row in rows:
            if row.get("role") == "actuator" and row["way"] == "out":
                row["hex"] = "00" * (len(row["hex"]) // 2)
        return [json.dumps(row).encode() + b"\n" for row in rows]

    path = mutilated(probed[0], tmp_path, no_answer_fits)

    async def opened() -> None:
        async with replayed(path, "actuator") as link:
            device = driver(voice_coil, type_of_actuator, ACTUATOR | {"silence_s": 0.5}, tmp_path, link.endpoint)
            try:
                await device.open()
            finally:
                await device.close()

    with pytest.raises(
        AssertionError, match=r"actuator on \S+: the driver sent .*; the recording has 00 .*\(line \d+\)$"
    ) as said:
        await opened()
    assert isinstance(said.value.__context__, LinkError)


@pytest.mark.full
async def test_a_mutilated_file_is_named_with_its_line(probed: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    def refused(change: Callable[[list[bytes]], list[bytes]]) -> str:
        with pytest.raises(ConfigError) as error:
            read_recording(mutilated(probed[0], tmp_path, change))
        return str(error.value)

    changed = str(tmp_path / "changed.jsonl")
    assert refused(lambda lines: lines[1:]).startswith(f"{changed}:1: has no header")
    assert refused(lambda lines: [*lines[:2], b"nonsense\n", *lines[2:]]).startswith(f"{changed}:3: is no JSON")
    odd = b'{"t_s":0,"role":"robot","link":"x","way":"in","hex":"0"}\n'
    assert refused(lambda lines: [lines[0], odd]).startswith(f"{changed}:2: non-hexadecimal")
    assert refused(lambda lines: [lines[0], b'{"t_s":0}\n']).startswith(f"{changed}:2: has no 'way'")
    with pytest.raises(ConfigError, match=r"'loader' is recorded; the file holds actuator, robot, spindle"):
        async with replayed(probed[0], "loader"):
            pass
    with pytest.raises(ConfigError, match=r"No such file"):
        read_recording(tmp_path / "none")


@pytest.mark.full
def test_what_a_power_cut_left_is_read(probed: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    whole, path = probed[0].read_bytes(), tmp_path / "cut.gz"
    path.write_bytes(whole[: len(whole) - 40])
    found = read_recording(path)
    assert cast(str, found.notes[0]).startswith("line ")
    assert "breaks off" in found.notes[0]
    assert 0 < len(found.passed) <= len(read_recording(probed[0]).passed)
