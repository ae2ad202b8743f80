"""``polishd run`` at the terminal: how each end is shown, of one cell and of several."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from polishd.cli import run as running
from polishd.cli.run import worst_exit_code
from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, with_values, write_demo
from polishd.daemon.app import CellRun
from polishd.daemon.runtime.events import safety_of
from polishd.model import errors
from polishd.model.events import DaemonFailed, PassStarted
from tests.unit.cli_result import Polishd

SUMMARY = {
    "outcome": "in_tolerance", "job": "demo", "cycles": [], "notes": [], "exit_code": 0, "run_dir": "runs/demo",
    **safety_of("in_tolerance", "", ()).data,
}  # fmt: skip


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> DemoFiles:
    return write_demo(tmp_path_factory.mktemp("cell") / "out", None, 2.0, 4, None)


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("outcome", "code"), [("in_tolerance", 0), ("cycles_used", 1), ("stopped", 1), ("diverged", 6)]
)
def test_run(polishd: Polishd, files: DemoFiles, outcome: str, code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []

    async def run_cells(cells: Sequence[CellRun], *, holds: bool) -> list[dict[str, Any]]:
        seen.extend(cell.config.process.correction for cell in cells)
        return [SUMMARY | {"outcome": outcome, "exit_code": code}]

    monkeypatch.setattr(running, "run_cells", run_cells)
    said = polishd("run", files.cell, "--json", "--correction", "linear")
    assert (said.code, json.loads(said.out)["outcome"], seen) == (code, outcome, ["linear"])
    *_, tool, robot, folder, after = said.err.splitlines()
    assert [tool, robot, folder] == ["tool off the part: yes", "robot at rest: yes", "run folder: runs/demo"]
    assert after.startswith("next: read report.html")


def test_the_last_lines_of_a_run_that_failed(
    polishd: Polishd, files: DemoFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One device did not confirm: which one, what may be, what to do about it, and how to go on."""
    facts = safety_of("failed", "SafetyStop: force", ("actuator: no answer", "spindle: dead")).data
    notes = ["09:00 ended: SafetyStop: force", "09:30 ended: LinkError: cut"]
    asked: list[bool] = []

    async def run_cells(cells: Sequence[CellRun], *, holds: bool) -> list[dict[str, Any]]:
        asked.append(holds)
        return [SUMMARY | facts | {"outcome": "failed", "exit_code": 7, "notes": notes}]

    monkeypatch.setattr(running, "run_cells", run_cells)
    said = polishd("run", files.cell, "--no-hold")
    assert (said.code, asked) == (7, [False])
    lines = said.err.splitlines()[-8:]
    assert lines[:2] == ["polishd: 09:00 ended: SafetyStop: force", "polishd: 09:30 ended: LinkError: cut"]
    assert lines[2:4] == ["tool off the part: not confirmed", "robot at rest: yes"]
    assert lines[4].startswith("actuator did not confirm: no answer; the tool may press on the part: switch")
    assert lines[5].startswith("spindle did not confirm: dead; it may still turn: switch its drive off")
    assert lines[6] == "run folder: runs/demo"
    assert f"polishd run {files.cell} starts a daemon, which holds; polishd resume {files.cell}" in lines[7]


CODES = {
    "ConfigError": 3, "PluginError": 3, "PlanRefused": 4, "LinkError": 5, "DeviceFault": 5, "DeviceRefused": 5,
    "ProtocolError": 5, "SafetyStop": 7, "MapError": 8, "WrongPart": 8, "StaleMap": 8, "ProgramError": 9,
    "ComputeError": 10, "PolishdError": 1,
}  # fmt: skip


@pytest.mark.one_of_each("code")
@pytest.mark.parametrize("when", ["before any begins", "as it begins"])
@pytest.mark.parametrize(("name", "code"), CODES.items())
def test_each_error_has_its_code(
    polishd: Polishd, files: DemoFiles, name: str, code: int, when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def run_cells(cells: Sequence[CellRun], *, holds: bool) -> list[dict[str, Any] | Exception]:
        error = getattr(errors, name)("what, where, and what to do")
        if when == "before any begins":
            raise error
        return [error]

    monkeypatch.setattr(running, "run_cells", run_cells)
    said = polishd("run", files.cell, "--json")
    error = {"ok": False, "error": "what, where, and what to do", "code": name, "exit_code": code}
    assert (said.code, json.loads(said.out)) == (code, error)
    assert said.err.splitlines()[-2:] == [
        "polishd: what, where, and what to do",
        "This run opened nothing and moved nothing",
    ]


# several cells


@pytest.fixture
def two(files: DemoFiles) -> list[str]:
    """Their files; the second one's cell is called otherwise."""
    other = files.out / "other.toml"
    cell = {"name": "other-cell", "state_dir": "other-state"}
    other.write_text(with_values(files.cell.read_text(), {"cell": cell}))
    return [str(files.cell), str(other)]


@pytest.mark.full
def test_each_cell_is_named_and_the_worst_code_counts(
    polishd: Polishd, two: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    facts = safety_of("failed", "SafetyStop: force", ("actuator: no answer",)).data

    async def run_cells(cells: Sequence[CellRun], *, holds: bool) -> list[dict[str, Any] | Exception]:
        for cell in cells:
            cell.show(PassStarted(cycle=0, blocks=3, dwell_s=60.0))
            cell.show(DaemonFailed(error="force", kind="SafetyStop"))
        return [SUMMARY | facts | {"outcome": "failed", "exit_code": 7, "notes": ["why"]}, errors.ComputeError("slow")]

    monkeypatch.setattr(running, "run_cells", run_cells)
    said = polishd("run", *two, "--json")
    answer = json.loads(said.out)
    assert (said.code, answer["exit_code"]) == (7, 7), "a safety stop is worse than a computation"
    assert answer["cells"]["bench-cell"]["outcome"] == "failed"
    error = {"ok": False, "error": "slow", "code": "ComputeError", "exit_code": 10}
    assert answer["cells"]["other-cell"] == error
    lines = said.err.splitlines()
    assert {"bench-cell: SafetyStop: force", "other-cell: SafetyStop: force"} <= set(lines)
    last = lines[lines.index("polishd: bench-cell: why") :]
    assert last[1:3] == ["bench-cell: tool off the part: not confirmed", "bench-cell: robot at rest: yes"]
    assert last[-2:] == ["polishd: other-cell: slow", "other-cell: This run opened nothing and moved nothing"]


def test_a_fault_of_ours_is_one_cells_affair(polishd: Polishd, two: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[dict[str, Any] | Exception] = [KeyError("bug"), SUMMARY]

    async def run_cells(cells: Sequence[CellRun], *, holds: bool) -> list[dict[str, Any] | Exception]:
        return ended

    monkeypatch.setattr(running, "run_cells", run_cells)
    said = polishd("run", *two, "--json")
    assert said.code == 1
    assert "polishd: bench-cell: KeyError: 'bug' (more in its log)" in said.err
    assert "other-cell: tool off the part: yes" in said.err
    ended.pop()
    with pytest.raises(KeyError):
        running.run_verb([Path(two[0])], None, holds=True, as_json=True)


def test_two_cells_have_two_state_folders(polishd: Polishd, two: list[str]) -> None:
    said = polishd("run", two[0], two[1], two[0])
    lines = Path(two[0]).read_text().splitlines()
    line = next(n for n, text in enumerate(lines, 1) if text.startswith("state_dir"))
    assert said.code == 3
    assert said.err.startswith(f"polishd: {two[0]}:{line}: cell.state_dir: is also that of {two[0]}; give each cell")


def test_the_worst_code() -> None:
    assert [worst_exit_code(codes) for codes in ([0, 0], [0, 1], [1, 10, 5], [10, 7])] == [0, 1, 10, 7]
