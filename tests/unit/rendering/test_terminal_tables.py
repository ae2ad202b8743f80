"""Tables for people: every figure in its column, nothing where there is none."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table

from polishd.cli.run import progress
from polishd.daemon.runtime.events import safety_of
from polishd.model.tolerance import LineResult
from polishd.rendering.terminal import (
    Terminal,
    cycle_table,
    emit,
    figure_table,
    key_table,
    outcome_tables,
    record_table,
    stderr,
    tolerance_table,
)

CYCLES: list[dict[str, Any]] = [
    {
        "pv_nm": 101.234, "rms_nm": 20.456, "lsf_rms_nm": 15.0, "band_rms_nm": 18.5,
        "predicted_rms_nm": 1.0, "dwell_s": 60.5, "executed_s": 61.25, "rate": 0.98765,
    },
    {
        "pv_nm": 9.0, "rms_nm": 1.5, "lsf_rms_nm": 1.0, "band_rms_nm": 1.25,
        "predicted_rms_nm": None, "dwell_s": None, "executed_s": None, "rate": None,
    },
]  # fmt: skip


def shown(table: Table) -> list[list[str]]:
    """Cells of each line."""
    console = Terminal(file=io.StringIO(), width=200)
    console.print(table)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    return [[cell.strip() for cell in line.strip("│┃ ").replace("┃", "│").split("│")] for line in text.splitlines()]


def test_cycles() -> None:
    title, _, header, _, first, last, _ = shown(cycle_table({"job": "j", "outcome": "in_tolerance", "cycles": CYCLES}))
    assert title == ["j: in_tolerance"]
    assert header == ["#", "PV nm", "RMS nm", "LSF nm", "predicted nm", "dwell s", "executed s", "rate"]
    assert first == ["0", "101.23", "20.46", "15.00", "1.00", "60.50", "61.25", "0.988"]
    assert last[:4] == ["1", "9.00", "1.50", "1.00"]
    assert not any(last[4:])


def test_an_interrupted_pass_is_no_pass_like_the_others() -> None:
    torn = {**CYCLES[0], "how": "interrupted", "executed_s": 15.125, "uncertain": [[18, 21], [30, 30]]}
    _, _, header, _, first, second, last, _ = shown(
        cycle_table({"job": "j", "outcome": "in_tolerance", "cycles": [torn, {**CYCLES[0], "how": "done"}, CYCLES[1]]})
    )
    assert header[-1] == "pass"
    assert first[-1] == "interrupted at 25%, 5 blocks uncertain"
    assert second[-1] == "0.988", "the others are as ever"
    assert not any(last[4:])


def test_the_tolerances_band_has_its_column() -> None:
    table = cycle_table({"job": "j", "outcome": "x", "cycles": CYCLES, "tolerance_period_mm": 7.0})
    header, first = shown(table)[2], shown(table)[4]
    assert first[header.index("> 7 mm nm")] == "18.50"


def judged(pv_nm: float) -> list[dict[str, Any]]:
    lines = [LineResult("RMS", pv_nm / 10, 2.0, "nm", 0.3), LineResult("PV", pv_nm, 12.0, "nm")]
    return [line.facts() for line in lines]


def test_the_drawings_lines_stand_below_the_worst_first() -> None:
    cycles = [{**CYCLES[0], "judged": judged(100.0)}, {**CYCLES[1], "judged": judged(18.0)}]
    summary = {"job": "j", "outcome": "x", "cycles": cycles}
    title, _, header, _, first, second, _ = shown(tolerance_table(summary))
    assert title == ["j: tolerance"]
    assert header == ["line", "limit", "0", "1", "last one holds"]
    assert first == ["PV", "12 nm", "100.00", "18.00", "no, 1.5 times the limit"]
    assert second == ["RMS", "2 nm", "10.00", "1.80", "yes; not sure: +- 0.3 nm"]
    assert isinstance(outcome_tables(summary), Group)
    assert isinstance(outcome_tables({**summary, "tolerance_nm": 2.0}), Table), "which is in the table of measurements"
    assert isinstance(outcome_tables({"job": "j", "outcome": "x", "cycles": CYCLES}), Table), "of an earlier polishd"


def test_a_bound_stands_beside_what_it_judges_even_of_a_short_tolerance() -> None:
    line = LineResult("RMS", 0.5, 2.0, "nm", 0.3, bound=1.25, removed="power")
    summary = {"job": "j", "outcome": "x", "tolerance_nm": 2.0, "cycles": [{**CYCLES[0], "judged": [line.facts()]}]}
    assert isinstance(outcome_tables(summary), Group)
    *_, row, _ = shown(tolerance_table(summary))
    assert row[-1] == "yes; at most 1.25 nm truly (95 %), guard band 0.75 nm, power removed"


def test_no_cycles() -> None:
    assert shown(cycle_table({"job": "j", "outcome": "failed", "cycles": []}))[0] == ["j: failed"]


def test_keys_and_records() -> None:
    assert ["part", "P-1"] in shown(key_table("t", [("part", "P-1"), ("n", 3)]))
    lines = shown(record_table("t", ("name", "n"), [("a", 1), ("b", None)]))
    assert ["name", "n"] in lines
    assert ["b", "None"] in lines


def test_json_holds_no_nan(capsys: Any) -> None:
    answer = {
        "a": math.nan,
        "b": [math.inf, {"c": np.float64("-inf")}],
        "d": np.float32(1.5),
        "e": np.arange(2),
        "f": Path("g"),
    }
    emit(answer, as_json=True, table=Table, lines=["for people"])
    assert json.loads(capsys.readouterr().out) == {"a": None, "b": [None, {"c": None}], "d": 1.5, "e": [0, 1], "f": "g"}


def test_lines_stand_below_the_table(capsys: Any) -> None:
    emit({}, as_json=False, table=lambda: key_table("t", [("part", "P-1")]), lines=["a [b]", "c"])
    assert capsys.readouterr().out.splitlines()[-2:] == ["a [b]", "c"]


def test_what_a_person_sees_of_a_run(capsys: Any) -> None:
    events: list[tuple[str, int | None, dict[str, Any]]] = [
        ("cell_opened", None, {}),
        ("map_measured", 0, {"rms_nm": 20.456, "pv_nm": 101.0, "band_rms_nm": 3.0, "notes": ["tilt [of] 150 nm"]}),
        ("estimates_updated", 1, {"rate": 1.0, "notes": ["the rate stays"]}),
        ("dwell_solved", 0, {"predicted_rms_nm": 1.0, "kkt_residual": 1e-5}),
        ("pass_started", 0, {"blocks": 100, "dwell_s": 60.0}),
        ("pass_progressed", 0, {"block": 50}),
        ("pass_ended", 0, {"executed_s": 61.0}),
        ("state_changed", None, safety_of("held", "by [order]", ("robot: [deaf]",)).data),
        ("state_changed", None, {"state": "polishing", "reason": ""}),
        ("daemon_failed", None, {"kind": "LinkError", "error": "[gone]"}),
        ("run_folder_completed", None, {}),
    ]
    with progress([("", Path("my cell.toml"))]) as (show,):
        for event in events:
            show(*event)
    captured = capsys.readouterr()
    assert captured.out == "", "stdout is for programs"
    for text in (
        "RMS 20.46 nm",
        "3.00 nm in the tolerance's band",
        "held: by [order]",
        "LinkError: [gone]",
        "note: tilt [of] 150 nm",
        "note: the rate stays",
    ):
        assert text in captured.err
    lines = captured.err.splitlines()
    held = lines.index("held: by [order]")
    assert lines[held + 1 : held + 3] == ["tool off the part: yes", "robot at rest: not confirmed"]
    assert lines[held + 3].startswith("robot did not confirm: [deaf]; it may still move")
    assert lines[held + 4].startswith("next: correct the cause, then run polishd resume 'my cell.toml'")
    assert stderr.stderr


def test_what_looks_like_markup_is_shown_as_it_is() -> None:
    for table in (record_table, figure_table):
        cells = shown(table("t [red]", ("name", "n"), [("m[red].dat", "1.0")]))
        assert cells[0] == ["t [red]"]
        assert any(line[0].startswith("m[red].dat") for line in cells)
