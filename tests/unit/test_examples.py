"""Every Python example of the documentation runs as it is written: here, or in the test that is named here."""

from __future__ import annotations

import ast
import builtins
import gzip
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from polishd.drivers.plc_robot.driver import PlcRobot
from polishd.drivers.plc_robot.variables import Recorded, RecordedDelivery
from polishd.drivers.transport.file_delivery import Folder
from polishd.model.events import RunFolderCompleted
from polishd.plugin_loader import load_plugins
from polishd.studies.cases import Case
from polishd.studies.engine import CaseResult, FinishedCase
from polishd.studies.result_store import ResultStore
from polishd.util.wire_recording import Way, WireMessage, header_line, passed_line, record_received, record_sent
from tests.fakes.plc_robot import PROFILE, Direct, FakePlc, cycling

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```(?:python|py|python3|pycon)\b[^\n]*\n(.*?)^```", re.DOTALL | re.MULTILINE)
NO_NUMBER = re.compile(r"(?<![\w.])[+-]?(?:nan|inf)(?![\w.])", re.IGNORECASE)

HERE = (
    "docs/tutorials/plugin.md",
    "docs/how-to/dwell.md",
    "docs/how-to/paths.md",
    "docs/how-to/recording.md",
    "docs/how-to/studies.md",
)
"""Pages whose examples this module runs."""
ELSEWHERE = {
    "docs/how-to/certificate.md": "tests/unit/reports/certificate/test_issue.py",
    "docs/how-to/drivers.md": "tests/unit/testing/test_drivers_page.py",
    "docs/how-to/plugins.md": "tests/unit/test_plugin_docs.py",
    "docs/how-to/recipe.md": "tests/unit/pipeline/test_docs.py",
    "docs/tutorials/first-plan.md": "tests/system/test_tutorials.py",
    "docs/tutorials/rehearsed-cell.md": "tests/system/test_tutorials.py",
    "docs/how-to/researcher.md": "tests/unit/test_analysis.py",
    "docs/how-to/universal-robots.md": "tests/system/test_tutorials.py",
}
"""Pages whose examples need what another test has: that test, which reads the page."""
NOT_RUN: dict[str, str] = {}
"""Examples that cannot run: ``page:line`` and the reason."""


@dataclass(frozen=True)
class Example:
    """A Python block of a page."""

    page: str
    line: int
    """Number of the first line of code."""
    code: str

    @property
    def name(self) -> str:
        return f"{self.page}:{self.line}"

    def run(self, names: dict[str, Any]) -> None:
        """Execute it in a session with these names; lines of a traceback are the page's."""
        exec(compile("\n" * (self.line - 1) + self.code, str(ROOT / self.page), "exec"), names)


def examples_of(page: str) -> list[Example]:
    text = (ROOT / page).read_text(encoding="utf-8")
    return [Example(page, text.count("\n", 0, found.start(1)) + 1, found[1]) for found in BLOCK.finditer(text)]


def pages() -> list[str]:
    found = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/**/*.md")]
    return sorted(str(path.relative_to(ROOT)) for path in found)


EXAMPLES = {page: found for page in pages() if (found := examples_of(page))}


@pytest.fixture
def examples_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT / "examples")


def say_numbers(printed: str) -> None:
    assert printed.strip()
    assert not NO_NUMBER.search(printed), printed


# every example has a test


def test_every_example_has_a_test_that_runs_it_or_a_reason() -> None:
    excused = {name.rpartition(":")[0] for name in NOT_RUN}
    assert set(EXAMPLES) == {*HERE, *ELSEWHERE, *excused}
    assert set(NOT_RUN) <= {one.name for found in EXAMPLES.values() for one in found}
    assert all(NOT_RUN.values())
    for page, test in ELSEWHERE.items():
        text = (ROOT / test).read_text(encoding="utf-8")
        assert page in text or Path(page).name in text, f"{test} does not read {page}"
        assert "```" in text, f"{test} does not take the examples out of {page}"


@pytest.mark.parametrize("one", [one for found in EXAMPLES.values() for one in found], ids=lambda one: one.name)
def test_an_example_is_python_and_defines_all_that_it_uses(one: Example) -> None:
    """Of a page whose examples are one session, the names of those before it count."""
    known = {name for before in EXAMPLES[one.page] if before.line <= one.line for name in _bound(before.code)}
    unknown = set(_used(one.code)) - known - set(dir(builtins))
    assert not unknown, f"{one.name} uses {', '.join(sorted(unknown))}, which no example defines"


def _bound(code: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(code)):
        match node:
            case ast.Import() | ast.ImportFrom():
                yield from ((alias.asname or alias.name.partition(".")[0]) for alias in node.names)
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                yield node.name
            case ast.arg():
                yield node.arg
            case ast.Name(ctx=ast.Store()):
                yield node.id
            case ast.ExceptHandler(name=str(name)):
                yield name
            case ast.MatchAs(name=str(name)):
                yield name


def _used(code: str) -> Iterator[str]:
    yield from (node.id for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name))


# those of pages without a test of their own


def test_the_plugin_of_the_tutorial(install: Any, capsys: pytest.CaptureFixture[str]) -> None:
    (one,) = EXAMPLES["docs/tutorials/plugin.md"]
    hooks = load_plugins([install("weekend", one.code, api=None)])
    hooks.report.require()
    (plugin,) = hooks.report.loaded
    assert plugin.implements("polishd_check_plan")
    assert plugin.implements("polishd_on_event")
    names: dict[str, Any] = {}
    one.run(names)
    assert len(names["polishd_check_plan"](None, None)) == (names["date"].today().weekday() >= 5)
    names["polishd_on_event"](RunFolderCompleted(run_dir="runs/1", outcome="in_tolerance"))
    assert capsys.readouterr().out == "in_tolerance runs/1\n"


def test_a_path_from_python() -> None:
    (one,) = EXAMPLES["docs/how-to/paths.md"]
    names: dict[str, Any] = {}
    one.run(names)
    assert names["points_mm"].shape[1] == 3
    assert len(names["points_mm"]) > 5000


@pytest.mark.full
def test_the_dwells_of_arrays(examples_folder: None, capsys: pytest.CaptureFixture[str]) -> None:
    first, curve, spread, tools = EXAMPLES["docs/how-to/dwell.md"]
    names: dict[str, Any] = {}
    for one in (first, curve, tools):
        one.run(names)
        say_numbers(capsys.readouterr().out)
    assert names["dwell"].certificate.predicted_rms_nm < 0.1
    assert len(names["rows"]) == len(names["curve"].points) > 10
    assert names["found"].certificate.predicted_rms_nm <= 2.0
    assert [one["tools"] for one in names["found"].tried] == [["R80"], ["R20"], ["R80", "R20"]]
    spread.run(names)
    say_numbers(capsys.readouterr().out)
    assert names["effect"].error <= 5e-3


async def test_a_recording_of_a_driver_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``line_tool`` is the driver of docs/how-to/drivers.md; a tool whose watchdog has lifted it is recorded."""
    driver = next(one for one in EXAMPLES["docs/how-to/drivers.md"] if "# line_tool.py" in one.code)
    (tmp_path / "line_tool.py").write_text(driver.code)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    asked: list[tuple[Way, bytes]] = [("out", b"?\n"), ("in", b"0.0 0.0 0.0 up 1\n")]
    said: list[tuple[Way, bytes]] = [("open", b""), *asked, *asked, ("end", b"")]
    record(tmp_path, [WireMessage(at * 0.1, "actuator", "tcp://h:1", way, data) for at, (way, data) in enumerate(said)])
    names: dict[str, Any] = {}
    EXAMPLES["docs/how-to/recording.md"][0].run(names)
    await names["test_the_case_of_monday"](tmp_path)


async def test_a_recording_of_a_controller_that_loads_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    fake, messages = FakePlc(tmp_path), list[WireMessage]()
    await _opened(fake, messages)
    record(tmp_path, messages)
    names: dict[str, Any] = {}
    EXAMPLES["docs/how-to/recording.md"][1].run(names)
    await names["test_the_case_of_tuesday"]()


async def _opened(fake: FakePlc, messages: list[WireMessage]) -> None:
    place = RecordedDelivery(Folder(fake.folder), "ftp://plc/programs")
    robot = PlcRobot("PLC", PROFILE, lambda: Recorded(Direct(fake), "opc.tcp://plc:4840", place), place)
    with record_received(messages.append), record_sent("robot"):
        async with cycling(fake):
            await robot.open()
            assert (await robot.status()).ready
            await robot.close()


def record(folder: Path, messages: list[WireMessage]) -> None:
    """Write the messages as the file of the page's examples."""
    lines = header_line("0", "cell", "", {}) + b"".join(passed_line(one, messages[0].at_s) for one in messages)
    (folder / "case.wire.jsonl.gz").write_bytes(gzip.compress(lines))


def test_the_table_of_a_study(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "DIR").mkdir()
    kept, cases = ResultStore(tmp_path / "DIR"), [Case(at, at, {}, "nothing", "exact", at, str(at)) for at in range(4)]
    came = [(True, 4.0, ""), (False, 6.0, ""), (True, 8.0, ""), (None, None, "the plant ended")]
    for case, (accepted, rms_nm, error) in zip(cases, came, strict=True):
        rows = () if error else ({"accepted": accepted, "true_rms_end_nm": rms_nm},)
        kept.add(FinishedCase(case, CaseResult(case.number, rows, error, 2.0, 1.0), 1))
    kept.merge(cases, "text")
    (one,) = EXAMPLES["docs/how-to/studies.md"]
    one.run({})
    (group,) = ast.literal_eval(capsys.readouterr().out)
    assert group == {
        "loop": "exact", "accepted_mean": pytest.approx(2 / 3), "true_rms_end_nm_approximate_median": 6.0,
    }  # fmt: skip
