"""Terms that may change within a job: one table, shown in the documentation, and errors that name the difference."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
from collections.abc import Callable
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import with_values, write_demo
from polishd.config.cell import CellConfig, load_config
from polishd.daemon.job.resume_checks import FILES, RULES, may_change, require_same, terms_of
from polishd.daemon.journal.journal import Journal
from polishd.model.errors import ConfigError
from tests.commissioned import forged


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    return write_demo(tmp_path / "demo", None, 2.0, 4, None).cell


def begin(cell: Path, program_sha256: str = "aa" * 32) -> CellConfig:
    """A job that has measured something."""
    config = load_config(cell)
    terms = terms_of(config, {}, program_sha256)
    config.state_dir.mkdir(exist_ok=True)
    with Journal.open(config.state_dir, job=config.job.id, part_id=config.part.id, terms=terms) as journal:
        journal.record_map(0, "bb", "x", {})
    return config


def go_on(cell: Path, program_sha256: str = "aa" * 32) -> None:
    config = load_config(cell)
    terms = terms_of(config, {}, program_sha256)
    with Journal.open(config.state_dir, job=config.job.id, part_id=config.part.id, terms=terms) as journal:
        assert journal.resumed
        require_same(config, terms, journal)


def change(cell: Path, section: str, values: dict[str, Any]) -> None:
    cell.write_text(with_values(cell.read_text(), {section: values}))


@pytest.mark.parametrize(
    ("section", "values"),
    [
        ("robot", {"address": "tcp://10.0.0.1:7700"}),
        ("metrology", {"timeout_s": 60.0}),
        ("dwell", {"cpu_limit_s": 99.0, "objective": "knee"}),
        ("limits", {"max_removal_nm": 500.0}),
        ("job", {"max_cycles": 9, "tolerance_nm": 0.9, "stream_ahead_s": 2.0}),
        ("cell", {"run_dir": "elsewhere"}),
    ],
)
def test_what_may_change(cell: Path, section: str, values: dict[str, Any]) -> None:
    begin(cell)
    change(cell, section, values)
    go_on(cell)


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("section", "values", "says"),
    [
        ("part", {"edge_mm": 7.5}, "part.edge_mm: is 7.5, the job 'demo' began with "),
        ("part", {"id": "other"}, "part.id: is 'other'"),
        ("part", {"alignment": "power"}, "part.alignment: is 'power'"),
        ("process", {"force_n": 11.0}, "process.force_n: is 11.0"),
        ("program", {"offset_mm": [0.0, 1.0, 0.0]}, "program.offset_mm: is [0.0, 1.0, 0.0]"),
        ("machine", {"accel_mm_s2": 77.0}, "machine.accel_mm_s2: is 77.0"),
        ("job", {"tolerance_period_mm": 5.0}, "job.tolerance_period_mm: is 5.0"),
        ("instrument", {"spike_threshold_mad": 9.0}, "instrument.spike_threshold_mad: is 9.0"),
    ],
)
def test_what_may_not_is_refused_with_place_and_both_values(
    cell: Path, section: str, values: dict[str, Any], says: str
) -> None:
    begin(cell)
    change(cell, section, values)
    with pytest.raises(ConfigError) as refused:
        go_on(cell)
    first, *_, last = str(refused.value).splitlines()
    assert re.match(rf"{re.escape(str(cell))}:\d+: ", first)
    assert says in first
    assert last.endswith("Restore them, or set a new job.id")


def test_all_that_differs_is_reported_and_nothing_else(cell: Path) -> None:
    begin(cell)
    change(cell, "part", {"edge_mm": 7.5})
    change(cell, "process", {"rpm": 900.0})
    change(cell, "dwell", {"cpu_limit_s": 99.0})
    with pytest.raises(ConfigError) as refused:
        go_on(cell)
    keys = [line.split(": ")[1] for line in str(refused.value).splitlines()[:-1]]
    assert keys == ["part.edge_mm", "process.rpm"]


def test_another_program_under_the_same_name_is_refused(cell: Path) -> None:
    begin(cell, "aa" * 32)
    with pytest.raises(ConfigError, match=r"program.path: is .*sha256 bbbbbbbbbbbb\), .*sha256 aaaaaaaaaaaa\)"):
        go_on(cell, "bb" * 32)


def test_the_same_program_under_another_name_is_the_same(cell: Path) -> None:
    config = begin(cell)
    config.program_path.rename(config.program_path.with_name("moved.rnc"))
    change(cell, "program", {"path": "moved.rnc"})
    go_on(cell)


def test_a_profile_that_was_edited_is_refused(cell: Path) -> None:
    config = begin(cell)
    assert config.profile_path is not None
    config.profile_path.write_text(config.profile_path.read_text() + "# mirrored after all\n")
    with pytest.raises(ConfigError, match=r"instrument.profile: is .*\(sha256 "):
        go_on(cell)


def test_a_job_of_an_earlier_polishd_says_how_it_can_be_finished(cell: Path) -> None:
    config = begin(cell)
    with Journal.open(config.state_dir, job=config.job.id, part_id="P") as journal:
        journal._store.write(("UPDATE job SET terms = 'null'", ()))
    with pytest.raises(ConfigError, match=r"journal\.v1\.sqlite as journal\.sqlite .* or set a new job.id"):
        go_on(cell)


@pytest.mark.full
def test_run_refuses_what_differs_before_it_asks_a_device(cell: Path) -> None:
    config = load_config(cell)
    assert config.profile_path is not None
    forged(config.profile_path)
    begin(cell, hashlib.sha256(config.program_path.read_bytes()).hexdigest())
    change(cell, "part", {"edge_mm": 7.5})
    command = [sys.executable, "-m", "polishd.cli.app", "run", str(cell)]
    said = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert said.returncode == 3, said.stderr
    assert "part.edge_mm: is 7.5, the job 'demo' began with" in said.stderr.replace("\n", " ")


def test_another_outline_in_the_same_file_is_another_part(cell: Path) -> None:
    text = cell.read_text()
    cell.write_text(text.replace("aperture_mm = 100.0", 'polygon_file = "corners.csv"'))
    corners = cell.parent / "corners.csv"
    corners.write_text("x_mm,y_mm\n40,30\n-40,30\n-40,-30\n")
    begin(cell)
    go_on(cell)
    corners.write_text("x_mm,y_mm\n40,30\n-40,30\n-40,-31\n")
    with pytest.raises(ConfigError, match=r"part\.polygon_file: .*corners\.csv"):
        go_on(cell)


def test_terms_are_json_and_hold_every_value(cell: Path) -> None:
    config = load_config(cell)
    terms = terms_of(config, {}, "aa" * 32)
    assert json.loads(json.dumps(terms)) == terms
    assert terms["part.aperture_mm"] == config.part.aperture_mm
    assert terms["program.path"]["sha256"] == "aa" * 32


# the table


def flattened(cell: Path) -> list[str]:
    return list(terms_of(load_config(cell), {}, ""))


def test_each_key_has_a_rule_and_each_rule_a_key(cell: Path) -> None:
    keys = [
        *flattened(cell),
        "roles.robot",
        "notify.mail.to",
        "loader.type",
        "signals.flow.unit",
        "tools.large.change_s",
        "tools.large.position_mm",
        "tools.large.rpm",
        "tools.large.force_max_n",
    ]  # of a cell with several devices and tools, and people
    fits: Callable[[str, str], bool] = fnmatchcase
    assert [key for key in keys if not any(fits(key, one) for rule in RULES for one in rule.keys)] == []
    assert [one for rule in RULES for one in rule.keys if not any(fits(key, one) for key in keys)] == []


def test_the_largest_force_may_change_and_the_force_not() -> None:
    assert may_change("process.force_max_n")
    assert may_change("tools.large.force_max_n")
    assert may_change("touch_off.force_max_n")
    assert not may_change("process.force_n")


def test_what_has_no_rule_may_not_change() -> None:
    assert not may_change("tomorrow.key")


def test_keys_that_name_files_may_not_change() -> None:
    assert [key for key in FILES if may_change(key)] == []


# programs that take turns

TWO = ["program.rnc", "between.rnc"]


def begin_with_two(cell: Path) -> CellConfig:
    change(cell, "program", {"path": TWO})
    config = load_config(cell)
    config.program_paths[1].write_bytes(b"(between)\n" + config.program_path.read_bytes())
    terms = terms_of(config, {}, "aa" * 32, "bb" * 32)
    config.state_dir.mkdir()
    with Journal.open(config.state_dir, job=config.job.id, part_id=config.part.id, terms=terms) as journal:
        journal.record_map(0, "cc", "x", {})
    return config


def go_on_with(cell: Path, *program_sha256: str) -> None:
    config = load_config(cell)
    terms = terms_of(config, {}, *program_sha256)
    with Journal.open(config.state_dir, job=config.job.id, part_id=config.part.id, terms=terms) as journal:
        require_same(config, terms, journal)


def test_a_job_goes_on_with_its_programs(cell: Path) -> None:
    config = begin_with_two(cell)
    go_on_with(cell, "aa" * 32, "bb" * 32)
    assert [one["sha256"] for one in terms_of(config, {}, "aa" * 32, "bb" * 32)["program.path"]] == [
        "aa" * 32,
        "bb" * 32,
    ]


@pytest.mark.parametrize(
    ("hashes", "shown"),
    [(("aa" * 32, "dd" * 32), "between.rnc (sha256 dddddddddddd)"), (("bb" * 32, "aa" * 32), "aaaaaaaaaaaa)]")],
    ids=["another second program", "another order"],
)
def test_another_program_among_several_is_refused(cell: Path, hashes: tuple[str, str], shown: str) -> None:
    begin_with_two(cell)
    with pytest.raises(ConfigError) as caught:
        go_on_with(cell, *hashes)
    first, todo = str(caught.value).splitlines()
    assert "program.path: is [program.rnc (sha256 " in first
    assert shown in first
    assert todo.startswith("the job has begun and cannot continue with these values")


def test_one_program_in_place_of_two_is_refused(cell: Path) -> None:
    begin_with_two(cell)
    change(cell, "program", {"path": "program.rnc"})
    with pytest.raises(
        ConfigError, match=r"program\.path: is program\.rnc \(sha256 a+\), the job 'demo' began with \["
    ):
        go_on_with(cell, "aa" * 32)


def test_a_tool_with_programs_of_its_own_leaves_the_hashes_of_the_cells_as_they_are(cell: Path) -> None:
    change(cell, "program", {"path": TWO})
    config = load_config(cell)
    for name in (*TWO, "own.rnc", "other.rnc"):
        config.resolve(name).write_bytes(name.encode())
    cell.write_text(cell.read_text() + '\n[tools.own]\nprogram = ["own.rnc", "other.rnc"]\n')
    terms = terms_of(load_config(cell), {}, "aa" * 32, "bb" * 32)
    known = [hashlib.sha256(name.encode()).hexdigest() for name in (*TWO, "own.rnc", "other.rnc")]
    assert [one["sha256"] for one in (*terms["program.path"], *terms["tools.own.program"])] == known


def test_a_program_of_a_later_tool_is_a_term_too(cell: Path) -> None:
    """The first tool has its own program; ``program.path`` is that of the second."""
    folder = cell.parent
    (folder / "own.rnc").write_bytes(b"(own)\n" + (folder / "program.rnc").read_bytes())
    cell.write_text(cell.read_text() + '\n[tools.first]\nprogram = "own.rnc"\n\n[tools.second]\n')
    before = terms_of(load_config(cell), {}, "aa" * 32)
    (folder / "program.rnc").write_bytes(b"(changed)\n" + (folder / "program.rnc").read_bytes())
    after = terms_of(load_config(cell), {}, "aa" * 32)
    assert {key for key in before if before[key] != after[key]} == {"program.path"}
