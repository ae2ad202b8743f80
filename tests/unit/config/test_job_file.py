"""A job's file laid over the cell's: what it may say, whose line an error names, and where its paths start."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.config.cell import CellConfig, load_config
from polishd.config.job_file import OF_THE_CELL, JobFile
from polishd.model.errors import ConfigError

JOB = """
[job]
id = "lens-7"
tolerance_nm = 3.5

[part]
id = "L-7"
aperture_mm = 60.0

[program]
path = "lens.rnc"
"""


@pytest.fixture
def cell(tmp_path: Path, example: str) -> CellConfig:
    path = tmp_path / "cell.toml"
    path.write_text(example)
    return load_config(path)


def job_file(tmp_path: Path, text: str) -> JobFile:
    path = tmp_path / "jobs" / "lens.toml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    return JobFile.read(path)


def refused(cell: CellConfig, job: JobFile) -> str:
    with pytest.raises(ConfigError) as caught:
        job.laid_over(cell)
    return str(caught.value).replace(f"{job.path}", "JOB")


def test_what_it_says_replaces_what_the_cell_says_and_nothing_else(cell: CellConfig, tmp_path: Path) -> None:
    laid = job_file(tmp_path, JOB).laid_over(cell)
    assert (laid.job.id, laid.job.tolerance_nm, laid.job.max_cycles) == ("lens-7", 3.5, cell.job.max_cycles)
    assert (laid.part.id, laid.part.aperture_mm, laid.part.origin_mm) == ("L-7", 60.0, cell.part.origin_mm)
    assert laid.state_dir == cell.state_dir
    assert laid.process == cell.process


def test_one_job_leaves_nothing_to_the_next(cell: CellConfig, tmp_path: Path) -> None:
    before = cell.effective()
    job_file(tmp_path, JOB + "[process]\nforce_n = 7.0\n").laid_over(cell)
    assert job_file(tmp_path, JOB).laid_over(cell).process.force_n == cell.process.force_n
    assert cell.effective() == before


def test_its_paths_start_from_its_own_folder(cell: CellConfig, tmp_path: Path) -> None:
    job = job_file(tmp_path, JOB + 'dialects = ["shop.toml"]\n')
    laid = job.laid_over(cell)
    assert laid.program_path == tmp_path / "jobs" / "lens.rnc"
    assert laid.dialect_paths == [tmp_path / "jobs" / "shop.toml"]
    assert job.names() == ["program.path", "program.dialects"]
    plain = job_file(tmp_path, JOB.replace('path = "lens.rnc"', "offset_mm = [1.0, 0.0, 0.0]"))
    assert plain.laid_over(cell).program_path == cell.program_path
    assert plain.names() == []


@pytest.mark.parametrize("section", [name for name in OF_THE_CELL if name != "include"])
def test_what_is_the_cells_is_refused_by_its_line(cell: CellConfig, tmp_path: Path, section: str) -> None:
    said = refused(cell, job_file(tmp_path, f"{JOB}[{section}]\nx = 1\n"))
    assert said.startswith(
        f"JOB:{JOB.count(chr(10)) + 1}: {section}: belongs into the cell's file; a job has sections "
    )
    assert "'dwell'" in said


LINES = """
[[tolerance]]
rms_nm = 1.5
"""


def test_the_jobs_tolerance_takes_the_place_of_the_cells_in_whichever_form(cell: CellConfig, tmp_path: Path) -> None:
    long = job_file(tmp_path, JOB.replace("tolerance_nm = 3.5\n", "") + LINES)
    laid = long.laid_over(cell)
    assert cell.job.tolerance_nm is not None
    assert (laid.job.tolerance_nm, [section.rms_nm for section in laid.tolerance]) == (None, [1.5])
    back = job_file(tmp_path, JOB).laid_over(laid)
    assert (back.job.tolerance_nm, back.tolerance) == (3.5, ())


def test_a_job_that_says_both_forms_is_refused_by_its_line(cell: CellConfig, tmp_path: Path) -> None:
    said = refused(cell, job_file(tmp_path, JOB + LINES))
    assert said.startswith("JOB:4: job.tolerance_nm: there are [[tolerance]] lines, too; keep one of both")


def test_it_includes_nothing(cell: CellConfig, tmp_path: Path) -> None:
    said = refused(cell, job_file(tmp_path, 'include = ["a.toml"]\n' + JOB))
    assert said.startswith("JOB:1: include: belongs into the cell's file")


def test_each_job_says_its_name_and_its_part(cell: CellConfig, tmp_path: Path) -> None:
    said = refused(cell, job_file(tmp_path, "[job]\ntolerance_nm = 3.0\n"))
    assert said.splitlines() == [
        "JOB:1: job.id: is missing; add it: id = ...",
        "JOB:1: part.id: is missing; add it: id = ...",
    ]


def test_errors_of_values_name_its_line_and_those_of_the_cell_the_cells(cell: CellConfig, tmp_path: Path) -> None:
    wrong = JOB.replace("tolerance_nm = 3.5", "tolerance_nm = -3.5")
    assert refused(cell, job_file(tmp_path, wrong)) == (
        "JOB:4: job.tolerance_nm: -3.5 is out of range; must be greater than 0.0"
    )
    laid = job_file(tmp_path, JOB).laid_over(cell)
    assert str(laid.error("process.force_n", "x")).startswith(f"{cell.path}:")
    assert str(laid.error("program.path", "x")) == f"{tmp_path / 'jobs' / 'lens.toml'}:11: program.path: x"


@pytest.mark.parametrize(
    ("text", "said"),
    [("[job", "JOB:1: this is not TOML"), ("job = 3\npart = 4\n", "JOB:1: job.id: is missing")],
)
def test_what_is_no_job_is_refused(cell: CellConfig, tmp_path: Path, text: str, said: str) -> None:
    assert refused(cell, job_file(tmp_path, text)).startswith(said)


def test_its_programs_start_from_its_own_folder_too(cell: CellConfig, tmp_path: Path) -> None:
    job = job_file(tmp_path, JOB.replace('path = "lens.rnc"', 'path = ["lens.rnc", "between.rnc"]'))
    laid = job.laid_over(cell)
    assert laid.program_paths == (tmp_path / "jobs" / "lens.rnc", tmp_path / "jobs" / "between.rnc")
    assert job.names() == ["program.path"]


def test_a_job_with_one_program_replaces_those_of_the_cell(cell: CellConfig, tmp_path: Path) -> None:
    cell.path.write_text(cell.path.read_text().replace('path = "program.rnc"', 'path = ["a.rnc", "b.rnc"]'))
    assert len((several := load_config(cell.path)).program_paths) == 2
    assert job_file(tmp_path, JOB).laid_over(several).program_paths == (tmp_path / "jobs" / "lens.rnc",)
