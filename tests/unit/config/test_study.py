"""A study's file: shipped files load, and each error names file and line once."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from polishd.config.study import CorrectionsStudy, PassesStudy, SpotsStudy, load_study
from polishd.model.errors import ComputeError, ConfigError
from polishd.model.process import HybridRobot
from tests.unit.studies.studies import EXAMPLES, FIG_12, TABLE_III, TABLE_IV, line_of, variant


def complaint(path: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load_study(path)
    return str(caught.value)


def test_the_shipped_studies_are_these_three() -> None:
    named = re.compile(r"^#   polishd study examples/", re.MULTILINE)
    assert {path for path in EXAMPLES.glob("*.toml") if named.search(path.read_text())} == {TABLE_IV, TABLE_III, FIG_12}


def test_table_iv_is_the_papers_setting() -> None:
    study = load_study(TABLE_IV)
    assert isinstance(study, CorrectionsStudy)
    process = study.tool_process()
    assert (process.tool_radius_mm, process.rpm, process.dip_deg, process.force_n) == (20.0, 1000.0, 15.0, 12.0)
    assert study.path.step_mm == study.process.grid_mm == 1.0
    assert study.solve.regularisation_nm2_s2 == 1e-9
    assert study.robot_model() == HybridRobot()


def test_table_iii_has_the_papers_rows() -> None:
    study = load_study(TABLE_III)
    assert isinstance(study, SpotsStudy)
    rows = [(s.size_mm, s.rpm, s.force_n, s.dip_deg, s.paper_jsd) for s in study.spots.values()]
    assert rows == [
        (20, 200, 4, 5, 0.298), (20, 400, 6, 10, 0.255), (20, 600, 6, 15, 0.206),
        (20, 1000, 10, 15, 0.172), (40, 1000, 12, 15, 0.107), (40, 1000, 12, 20, 0.132),
    ]  # fmt: skip
    assert study.seconds == 60.0


def test_fig_12_is_ten_passes() -> None:
    study = load_study(FIG_12)
    assert isinstance(study, PassesStudy)
    assert study.passes == 10


@pytest.mark.parametrize(
    ("old", "new", "key", "says"),
    [
        ("step_mm = 1.0", "stepp_mm = 1.0", "stepp_mm", "path.stepp_mm: unknown key; did you mean 'step_mm'?"),
        ("dip_deg = 15.0", "dip_deg = 90.0", "dip_deg", "process.dip_deg: 90.0 is out of range; must be less than 90"),
        ("step_mm = 1.0", 'step_mm = "1"', "step_mm", "path.step_mm: must be a number"),
        ("step_mm = 1.0", "step_mm = nan", "step_mm", "path.step_mm: nan is not allowed"),
        ("rms_nm = 18.5", "rms_nm = -1.0", "rms_nm", "surface.rms_nm: -1.0 is out of range"),
        ("rms_nm = 18.5", 'file = "a.dat"\nrms_nm = 18.5', "file", "surface.file: "),
        ("rms_nm = 18.5", "", "[surface]", "surface.rms_nm: a random surface needs rms_nm and period_mm"),
        ("[33.0, 120.0]", "[120.0, 33.0]", "period_mm", "surface.period_mm: [120.0, 33.0] is not a range"),
        ("[33.0, 120.0]", "[0.0, 33.0]", "period_mm", "surface.period_mm: must be above 0"),
        ("seed = 3", "seed = -3", "seed", "surface.seed: -3 is out of range"),
        ("unreachable = 0.005", "unreachable = 1.0", "unreachable", "solve.unreachable: 1.0 is out of range"),
        ("edge_mm = 3.0", "edge_mm = 30.0", "edge_mm", "part.edge_mm: no clear aperture is left"),
        ('type = "hybrid"', 'type = "delta"', "[kinematics]", "must be 'hybrid', 'serial' or 'measured'"),
        (
            'type = "hybrid"',
            "limb_stiffness_n_per_mm = -1.0",
            "limb",
            "limb_stiffness_n_per_mm: -1.0 is out of range",
        ),
        ("step_mm = 1.0", "step_mm = 0.01", "[path]", "path: 4.1e+07 dwell points or samples; at most"),
        ('"fixed"', '"fixd"', "dip_direction", "compliance.dip_direction: 'fixd' is not allowed"),
        ('"corrections"', '"correction"', "kind", "kind: 'correction' is not allowed; set one of 'corrections', "),
        ('kind = "corrections"', "", "", "kind: is missing; set one of 'corrections', 'loop', 'passes', 'paths', "),
    ],
)
def test_what_is_wrong_is_said_with_file_and_line(tmp_path: Path, old: str, new: str, key: str, says: str) -> None:
    path = variant(tmp_path, TABLE_IV, (old, new))
    line = line_of(path, key) if key else 1
    said = complaint(path)
    assert said.startswith(f"{path}:{line}: "), said
    assert says in said
    assert "\n" not in said


def test_two_faults_are_two_lines(tmp_path: Path) -> None:
    path = variant(tmp_path, TABLE_IV, ("dip_deg = 15.0", "dip_deg = 95.0"), ("force_n = 12.0", "force_n = 0.0"))
    assert [line.split(": ")[1] for line in complaint(path).splitlines()] == ["process.force_n", "process.dip_deg"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("rpm = 600.0", "rpm = 0.0", "spots.3.rpm: 0.0 is out of range; must be greater than 0"),
        ("rpm = 600.0", "rmp = 600.0", "spots.3.rmp: unknown key; did you mean 'rpm'?"),
        ("paper_jsd = 0.206", "paper_jsd = -1.0", "spots.3.paper_jsd: -1.0 is out of range"),
    ],
)
def test_a_spots_fault_is_placed_in_its_own_table(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = variant(tmp_path, TABLE_III, (old, new))
    said = next(line for line in complaint(path).splitlines() if says in line)
    assert said.startswith(f"{path}:{line_of(path, new)}: ")


def test_a_study_of_no_spots_is_refused(tmp_path: Path) -> None:
    text = TABLE_III.read_text()
    path = tmp_path / "none.toml"
    path.write_text(text[: text.index("[spots.1]")])
    assert f"{path}:1: spots: is missing; add it" in complaint(path)


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    said = complaint(tmp_path / "none.toml")
    assert said.endswith("cannot be read: No such file or directory; name a TOML file")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe")
    assert "is not UTF-8 text (byte 0)" in complaint(binary)
    broken = tmp_path / "broken.toml"
    broken.write_text("kind = \n")
    assert "this is not TOML" in complaint(broken)
    assert "broken.toml:1: " in complaint(broken)


def test_what_cannot_be_computed_is_blamed_on_the_key() -> None:
    study = load_study(TABLE_IV)
    with pytest.raises(ConfigError) as caught, study.blame("process.dip_deg"):
        raise ComputeError("no such contact")
    line = line_of(TABLE_IV, "dip_deg")
    assert str(caught.value) == f"{TABLE_IV}:{line}: process.dip_deg: no such contact"
    with pytest.raises(ConfigError, match=r"^as it was$"), study.blame("part"):
        raise ConfigError("as it was")


def test_paths_start_from_the_files_folder(tmp_path: Path) -> None:
    study = load_study(variant(tmp_path, TABLE_IV))
    assert study.resolve("maps/a.dat") == tmp_path / "maps" / "a.dat"


def test_a_measured_robot_is_a_table_beside_the_file(tmp_path: Path) -> None:
    path = variant(tmp_path, TABLE_IV, ('type = "hybrid"', 'type = "measured"\ntable = "none.csv"'))
    study = load_study(path)
    assert isinstance(study, CorrectionsStudy)
    with pytest.raises(ConfigError, match=r"none\.csv: cannot be read"):
        study.robot_model()


@pytest.mark.parametrize(
    ("study", "after", "line", "says"),
    [
        (TABLE_IV, "edge_mm = 3.0", 'form = "form.dat"', "part.form: "),
        (TABLE_IV, "grid_mm = 1.0", 'correction = "linear"', "process.correction: "),
        (
            TABLE_III,
            'preston = "1.49e-9 cm2/N"',
            'removal_model = "hertz_preston"',
            "process.removal_model: ",
        ),
        (FIG_12, "edge_mm = 5.0", 'form = "form.dat"', "part.form: "),
        (FIG_12, "edge_mm = 5.0", 'alignment = "tilt"', "part.alignment: "),
    ],
)
def test_what_a_study_cannot_use_is_refused(tmp_path: Path, study: Path, after: str, line: str, says: str) -> None:
    path = variant(tmp_path, study, (after, f"{line}\n{after}"))
    assert complaint(path).startswith(f"{path}:{line_of(path, line)}: {says}")
