"""The command line: what it prints for programs, and the exit code of each kind of end."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from polishd import __version__
from polishd.console import demo, verbs
from polishd.console.demo_files import DemoFiles, demo_program, with_values, write_demo
from polishd.daemon import app as daemon_app
from polishd.daemon import client
from polishd.daemon.config import load_config
from polishd.model import errors
from polishd.model.errors import DeviceFault, PolishdError
from tests.unit.console.said import Polishd, Said

SUMMARY = {"outcome": "in_tolerance", "job": "demo", "cycles": [], "notes": []}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> DemoFiles:
    """A small part's."""
    found = write_demo(tmp_path_factory.mktemp("cell") / "out", None, 2.0, 4, None)
    change = {"part": {"aperture_mm": 20.0}, "process": {"grid_mm": 2.0}}
    found.cell.write_text(with_values(found.cell.read_text(), change))
    config = load_config(found.cell)
    config.program_path.write_bytes(demo_program(config))
    return found


def test_version(polishd: Polishd) -> None:
    assert polishd("version") == Said(0, f"{__version__}\n", "")


@pytest.mark.parametrize("words", [["polsih"], ["check"], ["run", "cell.toml", "--correction", "some"], ["--jsn"]])
def test_usage(polishd: Polishd, words: list[str]) -> None:
    assert polishd(*words).code == 2


# check


def test_check(polishd: Polishd, files: DemoFiles) -> None:
    said = polishd("check", files.cell, "--json")
    facts = json.loads(said.out)
    assert said.code == 0
    assert "timed points" in facts["program"]
    assert facts["correction"] == "exact"
    people = polishd("check", files.cell)
    assert (people.code, "nothing was opened" in people.out) == (0, True)


@pytest.mark.parametrize(
    ("change", "code", "says"),
    [
        ({"dwell": {"solver": "newton"}}, 3, "newton_cg"),
        ({"program": {"path": "gone.rnc"}}, 9, "gone.rnc"),
        ({"robot": {"type": "robot"}}, 3, "robot_link"),
        ({"plugins": {"load": ["rnc_robot", "rnc_rboot"]}}, 3, "rnc_rboot"),
        ({"part": {"aperture_mm": -1.0}}, 3, "aperture_mm"),
        ({"part": {"origin_mm": [9000.0, 0.0, 2315.0]}}, None, ""),
    ],
)
def test_what_check_finds(
    polishd: Polishd, files: DemoFiles, change: dict[str, Any], code: int | None, says: str
) -> None:
    wrong = files.out / "wrong.toml"
    wrong.write_text(with_values(files.cell.read_text(), change))
    said = polishd("check", wrong)
    assert said.out == ""
    assert said.code == code if code is not None else said.code > 2
    assert said.err.startswith("polishd: ")
    assert says in said.err


def test_a_config_that_is_not_there(polishd: Polishd, tmp_path: Path) -> None:
    for verb in ("check", "run", "probe", "status", "hold", "resume", "stop", "plugins"):
        said = polishd(verb, tmp_path / "gone.toml")
        assert (said.code, "gone.toml" in said.err) == (3, True), verb


# plan


def test_plan_refuses_what_is_there(polishd: Polishd, files: DemoFiles) -> None:
    program = files.out / "program.rnc"
    said = polishd("plan", files.cell, program, "--program", program, "--out", files.out)
    assert (said.code, "exists already" in said.err) == (3, True)


def test_plan_refuses_a_map_that_is_none(polishd: Polishd, files: DemoFiles, tmp_path: Path) -> None:
    program = files.out / "program.rnc"
    said = polishd("plan", files.cell, program, "--program", program, "--out", tmp_path / "plan")
    assert (said.code, "no loaded reader knows this file" in said.err) == (8, True)
    assert not (tmp_path / "plan").exists()


# the daemon's verbs


def test_no_daemon(polishd: Polishd, files: DemoFiles) -> None:
    for verb in ("status", "hold", "resume", "stop"):
        assert polishd(verb, files.cell).code == 5, verb


@pytest.mark.parametrize("verb", ["hold", "resume", "stop"])
def test_orders(polishd: Polishd, files: DemoFiles, verb: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Path, str]] = []

    def request(state_dir: Path, word: str) -> dict[str, Any]:
        asked.append((state_dir, word))
        return {"ok": True, "state": "held"}

    monkeypatch.setattr(client, "request", request)
    assert json.loads(polishd(verb, files.cell, "--json").out) == {"ok": True, "state": "held"}
    assert asked == [(files.state_dir, verb)]


def test_status(polishd: Polishd, files: DemoFiles, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = {"ok": True, "state": "held", "reason": "by order", "unsafe": [], "cycles": [{"rms_nm": 20.456}]}
    monkeypatch.setattr(client, "request", lambda state_dir, verb: answer)
    assert json.loads(polishd("status", files.cell, "--json").out) == answer
    people = polishd("status", files.cell).out
    assert "RMS 20.46 nm" in people
    assert "by order" in people
    assert "unsafe" not in people, "nothing to say"


@pytest.mark.parametrize(
    ("outcome", "code"), [("in_tolerance", 0), ("cycles_used", 1), ("stopped", 1), ("diverged", 6)]
)
def test_run(polishd: Polishd, files: DemoFiles, outcome: str, code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []

    async def run_cell(config: Any, hooks: Any, *others: Any, **more: Any) -> dict[str, Any]:
        seen.append(config.process.correction)
        return SUMMARY | {"outcome": outcome}

    monkeypatch.setattr(daemon_app, "run_cell", run_cell)
    said = polishd("run", files.cell, "--json", "--correction", "linear")
    assert (said.code, json.loads(said.out)["outcome"], seen) == (code, outcome, ["linear"])


CODES = {
    "ConfigError": 3, "PluginError": 3, "PlanRefused": 4, "LinkError": 5, "DeviceFault": 5, "DeviceRefused": 5,
    "ProtocolError": 5, "SafetyStop": 7, "BadMap": 8, "WrongPart": 8, "StaleMap": 8, "ProgramError": 9,
    "ComputeError": 10, "PolishdError": 1,
}  # fmt: skip


@pytest.mark.parametrize(("name", "code"), CODES.items())
def test_each_error_has_its_code(
    polishd: Polishd, files: DemoFiles, name: str, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def run_cell(*arguments: Any, **more: Any) -> dict[str, Any]:
        raise getattr(errors, name)("what, where, and what to do")

    monkeypatch.setattr(daemon_app, "run_cell", run_cell)
    said = polishd("run", files.cell, "--json")
    assert (said.code, said.out) == (code, "")
    assert "polishd: what, where, and what to do" in said.err


def test_probe_with_nobody_there(polishd: Polishd, files: DemoFiles) -> None:
    said = polishd("probe", files.cell)
    assert said.code == 5
    assert "actuator" in said.err


# plugins


def test_plugins(polishd: Polishd) -> None:
    said = json.loads(polishd("plugins", "--json").out)
    names = [plugin["name"] for plugin in said["loaded"]]
    assert {"rnc_robot", "voice_coil", "spindle", "interferometer", "run_report"} <= set(names)
    assert said["refused"] == []
    brings = {plugin["name"]: plugin["brings"] for plugin in said["loaded"]}
    solvers = brings["dwell_solvers"]["polishd_dwell_solvers"]
    own = ["auto", "newton_cg", "douglas_rachford", "interior_point", "lucy_richardson"]
    assert solvers[:6] == [*own, "qp"]
    assert "qp:clarabel" in solvers
    assert "checks and events" in polishd("plugins").out


def test_a_plugin_that_is_refused_is_told_and_fails(polishd: Polishd, files: DemoFiles) -> None:
    wrong = files.out / "plugins.toml"
    wrong.write_text(with_values(files.cell.read_text(), {"plugins": {"load": ["rnc_robot", "nobody"]}}))
    said = polishd("plugins", wrong, "--json")
    answer = json.loads(said.out)
    assert said.code == 3
    assert [plugin["name"] for plugin in answer["loaded"]] == ["rnc_robot"]
    assert answer["refused"][0]["name"] == "nobody"


# the demo


def test_a_demo_does_not_write_into_what_is_there(polishd: Polishd, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert polishd("demo", "--out", tmp_path).code == 3
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_a_simulator_that_does_not_start_is_told(
    polishd: Polishd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuses(*arguments: object) -> None:
        raise DeviceFault("the simulated cell did not start: port 1 is taken")

    monkeypatch.setattr(demo, "simulated_cell", refuses)
    monkeypatch.setattr(demo.signal, "signal", lambda *arguments: None)  # this process keeps its own
    said = polishd("demo", "--out", tmp_path / "out")
    assert (said.code, "did not start" in said.err) == (5, True)


def test_load_cell_overrides_the_correction(files: DemoFiles) -> None:
    config, hooks = verbs.load_cell(files.cell, "none")
    assert config.process.correction == "none"
    assert len(hooks.report.loaded) == len(config.plugins.load)
    assert issubclass(errors.PluginError, PolishdError)
