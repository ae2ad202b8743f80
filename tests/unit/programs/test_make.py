"""``polishd program make``: files, messages and refusals."""

from __future__ import annotations

import inspect
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from PIL import Image
from typer.testing import CliRunner, Result

from polishd.cli.program import make
from polishd.config.cell import load_config
from polishd.config.cell_sections import InstrumentSection
from polishd.model.errors import ComputeError, ConfigError, MapError, PolishdError, ProgramError
from polishd.model.outline import hexagon, polygon
from polishd.model.process import FLAT, Optic
from polishd.model.program import Program
from polishd.model.surface import Grid
from polishd.pipeline import precheck, steps
from polishd.pipeline.build_recipe import make_recipe
from polishd.plugin_loader import load_own
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.formats import read
from polishd.process.frames import dips_deg
from polishd.process.optic_surface import sag_mm, unit_normals
from polishd.process.toolpath.apertures import TURN_LIMIT_DEG
from polishd.programs.make import UNCHECKED, dialect_of, make_path, own_path, quiet_lines
from polishd.programs.options import MakeOptions
from polishd.sim_backends.common.metropro import DatMap, pack
from tests.unit.cli_result import Polishd

EXAMPLE = Path(__file__).parents[3] / "examples" / "cell.toml"
OFF_AXIS = ("--optic", "asphere:150,-0.8,1e-8,-1e-13", "--offset", "30", "-10")
OFF_AXIS_OPTIC = Optic(150.0, -0.8, (1e-8, -1e-13), (30.0, -10.0))

app = typer.Typer()
app.command()(make)


def call(*words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def made(tmp_path: Path, *words: object, to: str = "rs274") -> tuple[dict[str, Any], Program]:
    """What was said, and the program that was written."""
    out = tmp_path / "made.nc"
    said = call(*words, "--out", out, "--json", "--dialect", to, "--force")
    assert said.exit_code == 0, (said.output, said.exception)
    return json.loads(said.stdout), read(dialect(to), out.read_bytes(), "made.nc")


def refused(tmp_path: Path, *words: object) -> tuple[PolishdError, list[str]]:
    """The error, and the files that are there all the same."""
    said = call(*words, "--out", tmp_path / "made.nc")
    assert isinstance(said.exception, PolishdError), said.output
    return said.exception, [file.name for file in tmp_path.iterdir()]


@pytest.mark.one_of_each
@pytest.mark.parametrize("shape", ["raster", "spiral"])
@pytest.mark.parametrize("to", ["rs274", "fanuc", "siemens", "codesys"])
def test_what_is_said_is_what_is_written(shape: str, to: str, tmp_path: Path) -> None:
    said, program = made(tmp_path, shape, "--aperture", "circle:30", *OFF_AXIS, to=to)
    assert said["points"] == program.n
    assert said["encoding"] == program.encoding == "feed"
    assert said["length_mm"] == pytest.approx(program.length_mm.sum(), rel=1e-5)
    assert said["duration_s"] == pytest.approx(program.time_s.sum(), rel=1e-4)
    assert said["duration_s"] == pytest.approx(said["length_mm"] / 15.0)
    places = np.vstack([program.start_mm[:1], program.end_mm])
    for k, name in enumerate("xyz"):
        np.testing.assert_allclose(said["bounds_mm"][name], [places[:, k].min(), places[:, k].max()], atol=1e-4)
    assert said["out"] == str(tmp_path / "made.nc")
    assert 0 < said["largest_turn_deg"] < 95


@pytest.mark.one_of_each
@pytest.mark.parametrize("shape", ["raster", "spiral"])
@pytest.mark.parametrize(
    ("words", "optic"),
    [
        ((), FLAT),
        (("--optic", "flat"), FLAT),
        (("--optic", "sphere:-90"), Optic(-90.0)),
        (("--optic", "conic:120,-1"), Optic(120.0, -1.0)),
        (OFF_AXIS, OFF_AXIS_OPTIC),
    ],
)
def test_points_and_axes_are_the_optics(shape: str, words: tuple[str, ...], optic: Optic, tmp_path: Path) -> None:
    _, program = made(tmp_path, shape, "--aperture", "ellipse:30,20", *words)
    plane = program.end_mm[:, :2]
    np.testing.assert_allclose(program.end_mm[:, 2], sag_mm(optic, plane), atol=1e-4)
    np.testing.assert_allclose(program.axis, unit_normals(optic, plane), atol=2e-6)


def test_a_dip_with_its_azimuth(tmp_path: Path) -> None:
    _, program = made(tmp_path, "raster", "--aperture", "circle:30", *OFF_AXIS, "--dip", 15, "--azimuth", 90)
    normal = unit_normals(OFF_AXIS_OPTIC, program.end_mm[:, :2])
    np.testing.assert_allclose(dips_deg(program.axis, normal), 15.0, atol=1e-3)
    assert (program.axis[:, 1] > normal[:, 1]).all()


def test_pitch_step_overrun_and_direction(tmp_path: Path) -> None:
    _, program = made(
        tmp_path, "raster", "--aperture", "rectangle:40,20", "--pitch", 2.5, "--step", 0.5, "--direction", 90,
        "--overrun", 3, "--landing", 9,
    )  # fmt: skip
    lines = np.unique(np.round(program.end_mm[np.abs(program.end_mm[:, 1]) < 5, 0], 4))
    np.testing.assert_allclose(np.diff(lines), 2.5, atol=1e-3)
    assert np.median(program.length_mm) == pytest.approx(0.5, rel=0.05)
    assert program.end_mm[:, 1].max() >= 13 - 1e-3
    assert np.abs(program.start_mm[0, :2]).max() >= 9 + 10 - 1e-3


@pytest.mark.parametrize("words", [(), ("--inwards",)])
def test_a_spiral_over_a_disc_begins_and_ends_beside_it(words: tuple[str, ...], tmp_path: Path) -> None:
    _, program = made(tmp_path, "spiral", "--aperture", "circle:30", *words)
    ends = np.stack([program.start_mm[0], program.end_mm[-1]])
    assert (np.hypot(*ends[:, :2].T) >= 20 - 1e-3).all()
    assert np.hypot(*program.end_mm[:, :2].T).min() < 1e-3, "and passes the centre"
    inward = np.argmin(np.hypot(*program.end_mm[:, :2].T))
    assert (inward > program.n / 2) == bool(words)


@pytest.mark.parametrize(
    ("encoding", "want"), [(None, "dwell"), ("dwell", "dwell"), ("feed", "feed"), ("inverse",) * 2]
)
def test_a_dwell_in_any_encoding(encoding: str | None, want: str, tmp_path: Path) -> None:
    """The same time at each point, wherever it is written."""
    words = () if encoding is None else ("--encoding", encoding)
    said, program = made(tmp_path, "spiral", "--aperture", "circle:20", "--dwell", 0.25, "--feed", 600, *words)
    assert said["encoding"] == program.encoding == want
    np.testing.assert_allclose(program.time_s, 0.25, rtol=3e-4)  # places have four decimals
    moving = said["length_mm"] / 10.0 if want == "dwell" else 0.0
    assert said["duration_s"] == pytest.approx(0.25 * said["points"] + moving)


def test_inverse_time_of_a_feed(tmp_path: Path) -> None:
    _, program = made(tmp_path, "raster", "--aperture", "circle:20", "--feed", 300, "--encoding", "inverse")
    assert program.encoding == "inverse"
    np.testing.assert_allclose(program.length_mm / program.time_s, 5.0, rtol=1e-3)


def test_a_mask_out_of_a_map(tmp_path: Path) -> None:
    side = (np.arange(80) - 39.5) * 0.5
    round_part = np.hypot(side[None, :], side[:, None]) <= 15
    map_file = tmp_path / "part.dat"
    map_file.write_bytes(pack(DatMap(np.where(round_part, 10.0, np.nan), 0.5)))
    _, program = made(tmp_path, "raster", "--aperture", f"mask:{map_file}")
    radius = np.hypot(*program.end_mm.T[:2])
    assert 16 < radius.max() < 26
    lines = np.unique(np.round(program.end_mm[:, 1], 3))
    np.testing.assert_allclose(lines[[0, -1]], [-16, 16], atol=0.6)
    measured = map_file.read_bytes()
    said = call("raster", "--aperture", f"mask:{map_file}", "--out", map_file)
    assert "is what is read" in str(said.exception)
    assert map_file.read_bytes() == measured


@pytest.mark.full
@pytest.mark.parametrize("aperture", ["hexagon:30", "polygon:corners.csv", None])
def test_a_part_that_is_not_round_is_covered_as_far_as_it_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, aperture: str | None
) -> None:
    """By the option, or because the cell's part is so: from the overrun on, no line runs over what is not the part."""
    monkeypatch.chdir(tmp_path)
    outline = hexagon(30) if aperture == "hexagon:30" else polygon([(15, 10), (-15, 10), (-12, -10), (12, -10)])
    Path("corners.csv").write_text("x_mm,y_mm\n" + "".join(f"{x},{y}\n" for x, y in outline.corners()))
    words = ["--aperture", aperture]
    if aperture is None:
        text = EXAMPLE.read_text().replace("aperture_mm = 100.0", 'polygon_file = "corners.csv"')
        Path("cell.toml").write_text(text)
        words = ["--cell", "cell.toml", "--landing", "5"]
    _, program = made(tmp_path, "raster", *words, "--pitch", "1", "--overrun", "1")
    inside = outline.inside_mm(*program.end_mm[3:-3, :2].T)
    assert inside.min() > -3.5
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-18, 18, 73), np.linspace(-18, 18, 73)))
    on_part = outline.contains(x, y)
    near = np.hypot(x[on_part, None] - program.end_mm[:, 0], y[on_part, None] - program.end_mm[:, 1]).min(axis=1)
    assert near.max() < 0.8


@pytest.mark.full
def test_a_cell_says_what_is_not_asked_for(tmp_path: Path) -> None:
    text = EXAMPLE.read_text()
    for key, value in (
        ("offset_mm = [0.0, 0.0, 0.0]", "offset_mm = [3.0, -2.0, 1.0]"),
        ("rotation_deg = 0.0\n", "rotation_deg = 25.0\n"),
        ('format = "rs274"', 'format = "fanuc"'),
        ("[part]\n", "[part]\ncurvature_radius_mm = 400.0\n"),
    ):
        assert key in text
        text = text.replace(key, value)
    cell = tmp_path / "cell.toml"
    cell.write_text(text)
    config = load_config(cell)
    assert call("raster", "--cell", cell, "--pitch", 4, "--out", tmp_path / "made.nc").exit_code == 0
    assert read(dialect("fanuc"), (tmp_path / "made.nc").read_bytes(), "made.nc").dialect == "fanuc"
    said, program = made(tmp_path, "raster", "--cell", cell, "--pitch", 4)
    part = steps.in_part_frame(make_recipe(config, load_own()), program)
    plane = part.end_mm[:, :2]
    np.testing.assert_allclose(part.end_mm[:, 2], sag_mm(Optic(400.0), plane), atol=3e-4)
    np.testing.assert_allclose(
        dips_deg(part.axis, unit_normals(Optic(400.0), plane)), config.process.dip_deg, atol=1e-3
    )
    assert np.hypot(*plane.T).max() > config.outline().radius_mm
    assert said["largest_turn_deg"] < 5
    assert said["not_checked"] == []


def test_options_override_the_cell() -> None:
    asked = MakeOptions("raster", Path("x"), cell=EXAMPLE, pitch_mm=5.0, optic="flat", dip_deg=0.0)
    upright = make_path(asked, load_config(EXAMPLE)).axis
    np.testing.assert_allclose(upright, np.tile([0, 0, 1], (len(upright), 1)), atol=1e-12)


@pytest.mark.full
def test_a_cell_chooses_the_distance_with_the_least_ripple_and_says_it(tmp_path: Path) -> None:
    said, _ = made(tmp_path, "raster", "--cell", EXAMPLE)
    config = load_config(EXAMPLE)
    chosen = quiet_lines(config, 1.0)
    assert said["pitch_mm"] == chosen.pitch_mm
    assert said["ripple"] == {"share": chosen.share, "share_high": chosen.share_high, "radius_error": 0.03}
    steps_mm = np.unique(np.round(own_path(config)[0][:, 1], 6))
    assert np.median(np.diff(steps_mm)) == pytest.approx(chosen.pitch_mm, rel=1e-3), "the demo's path has it, too"


@pytest.mark.full
def test_more_time_buys_less_ripple_and_less_time_keeps_to_its_budget(tmp_path: Path) -> None:
    (tmp_path / "long").mkdir()
    (tmp_path / "short").mkdir()
    whole, _ = made(tmp_path / "long", "raster", "--cell", EXAMPLE, "--time-budget", 1500)
    quick, _ = made(tmp_path / "short", "raster", "--cell", EXAMPLE, "--time-budget", 250)
    assert whole["pitch_mm"] < 1.0 < quick["pitch_mm"]
    assert whole["ripple"]["share_high"] < quick["ripple"]["share_high"] / 3
    assert whole["duration_s"] <= 1500
    assert quick["duration_s"] <= 250


def test_a_spiral_counts_with_lines_of_all_directions() -> None:
    config = load_config(EXAMPLE)
    spiral = quiet_lines(config, 1.0, shape="spiral")
    each = [quiet_lines(config, 1.0, direction_deg=turn).share_high for turn in (0.0, 90.0)]
    assert spiral.share_high >= min(each)


@pytest.mark.parametrize(
    "words",
    [("--time-budget", "100"), ("--cell", str(EXAMPLE), "--pitch", "1", "--time-budget", "100")],
)
def test_a_budget_needs_a_cell_and_chooses_the_distance(tmp_path: Path, words: tuple[str, ...]) -> None:
    found = call("raster", "--aperture", "circle:20", *words, "--out", tmp_path / "made.nc")
    assert found.exit_code == 2
    assert "--time-budget" in found.stderr


def cell_with(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = EXAMPLE.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "cell").mkdir()
    path = tmp_path / "cell" / "cell.toml"
    path.write_text(text)
    return path


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("words", [("raster",), ("spiral",), ("spiral", "--inwards")])
def test_what_is_made_for_a_cell_is_what_its_plan_and_run_take(tmp_path: Path, words: tuple[str, ...]) -> None:
    cell = cell_with(tmp_path)
    assert call(*words, "--cell", cell, "--pitch", 4, "--out", tmp_path / "made.nc").exit_code == 0
    without_profile = load_config(cell).model_copy(update={"instrument": InstrumentSection()})
    recipe = make_recipe(without_profile, load_own())
    program = steps.read_program(recipe, tmp_path / "made.nc")
    plan = precheck.shortest_time_s(recipe, program)
    assert steps.violations(recipe, plan) == []
    answer = steps.effect_of(replace(recipe, grid_mm=4.0), program, Grid(30, 30, 4.0))
    assert np.isfinite(answer.gamma).all()


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("changes", "words", "says"),
    [
        ((("[300.0, 220.0, 2315.0]", "[490.0, 355.0, 2315.0]"),), (), ("point ", "singular within")),
        ((), ("--aperture", "rectangle:40,20"), ("contact starts at", "contact ends at", "digs a pit")),
        ((), ("--dip", "0"), ("states no tool axis", "post it with its axis")),
        ((), ("--dip", "5"), ("the program's tool axis is dipped: the dip",)),
        ((), ("--landing", "900"), ("outside",)),
        ((("max_pass_s = 86400.0", "max_pass_s = 20.0"),), (), ("more than limits.max_pass_s = 20 s: set it to",)),
    ],
)
def test_what_its_plan_or_run_would_refuse_is_not_written(
    tmp_path: Path, changes: tuple[tuple[str, str], ...], words: tuple[str, ...], says: tuple[str, ...]
) -> None:
    cell = cell_with(tmp_path, *changes)
    error, files = refused(tmp_path, "raster", "--cell", cell, "--pitch", 4, *words)
    assert isinstance(error, ProgramError)
    for word in says:
        assert word in str(error)
    assert files == ["cell"]


@pytest.mark.full
def test_a_program_replaces_one_in_another_language_though_the_cell_has_a_touch_off(tmp_path: Path) -> None:
    """The touch-off is made like the program that there is, which is not the one to come."""
    path = load_config(EXAMPLE).program_path.name
    cell = cell_with(tmp_path, ('format = "rs274"', 'format = "inform"'))
    program = cell.parent / path
    program.write_text("G21 G90\nG1 X0 Y0 Z0 F100\n")
    done = call("raster", "--cell", cell, "--pitch", 4, "--out", program, "--force")
    assert done.exit_code == 0, done.exception
    assert program.read_bytes().startswith(b"/JOB")


def test_without_a_cell_it_says_what_it_could_not_check(tmp_path: Path) -> None:
    said, _ = made(tmp_path, "raster", "--aperture", "circle:30")
    assert said["not_checked"] == list(UNCHECKED)
    shown = " ".join(call("raster", "--aperture", "circle:30", "--out", tmp_path / "x.nc").stdout.split())
    assert "not checked without --cell" in shown
    assert "singular poses" in shown


def test_a_fixed_azimuth_overrides_how_the_cell_dips() -> None:
    config = load_config(EXAMPLE)
    asked = MakeOptions("raster", Path("x"), cell=EXAMPLE, pitch_mm=5.0, azimuth_deg=-90.0)
    axis = make_path(asked, config).axis
    np.testing.assert_allclose(axis[:, 0], 0, atol=1e-12)
    assert (axis[:, 1] < 0).all()


def test_the_limit_of_turns_is_the_paths() -> None:
    """The option's default stands in the signature, where a late import cannot reach."""
    assert inspect.signature(make).parameters["turn_limit_deg"].default == TURN_LIMIT_DEG


@pytest.mark.full
def test_no_program_is_written_without_its_picture(tmp_path: Path) -> None:
    for picture, why in ((tmp_path / "none" / "x.png", "cannot be written"), (tmp_path / "made.nc", "name two files")):
        error, there = refused(tmp_path, "raster", "--aperture", "circle:10", "--picture", picture)
        assert why in str(error)
        assert there == []


@pytest.mark.full
def test_people_get_a_table_and_a_picture(tmp_path: Path) -> None:
    picture = tmp_path / "path.png"
    said = call("spiral", "--aperture", "annulus:40,12", "--out", tmp_path / "x.nc", "--picture", picture, *OFF_AXIS)
    assert said.exit_code == 0, said.output
    flowing = " ".join(said.stdout.split())
    for word in ("points", "time in: feed", "length", "duration", "largest turn of the wrist", "written to"):
        assert word in flowing
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert("RGB"), dtype=float)
    assert min(pixels.shape[:2]) > 300
    assert pixels.std() > 10
    assert pixels.shape[1] > pixels.shape[0], "two panels side by side"


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("--aperture", "circle:x"),
        ("--aperture", "circle:10,20"),
        ("--aperture", "square:10"),
        ("--aperture", "mask:"),
        ("--aperture", "circle:10", "--optic", "sphere"),
        ("--aperture", "circle:10", "--optic", "flat:1"),
        ("--aperture", "circle:10", "--optic", "asphere:100,1"),
        ("--aperture", "circle:10", "--optic", "mirror:3"),
        ("--aperture", "circle:10", "--encoding", "dwell"),
        ("--aperture", "circle:10", "--dwell", "0"),
        ("--aperture", "circle:10", "--dwell", "0", "--encoding", "feed"),
        ("--aperture", "circle:10", "--feed", "-1"),
        ("--aperture", "circle:10", "--feed", "nan"),
    ],
)
def test_usage(words: tuple[str, ...], tmp_path: Path) -> None:
    said = call("raster", "--out", tmp_path / "x.nc", *words)
    assert said.exit_code == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "error", "what"),
    [
        (("--aperture", "circle:-5"), ComputeError, "the aperture's width is -5 mm"),
        (("--aperture", "circle:100", "--optic", "sphere:50"), ComputeError, "50 mm from its axis"),
        (("--aperture", "circle:20", "--optic", "sphere:0"), ComputeError, "radius of curvature is 0"),
        (("--aperture", "circle:20", "--pitch", 0), ComputeError, "the pitch is 0 mm"),
        (("--aperture", "circle:20", "--optic", "sphere:99", "--turn-limit", 20), ComputeError, "the wrist turns by"),
        (("--aperture", "circle:20", "--dip", 95), ComputeError, "the dip is 95 deg"),
        (("--aperture", "circle:20", "--feed", 1e-9), ProgramError, "leave a feed of 0"),
        (("--aperture", "circle:20", "--dwell", 1e-7), ProgramError, "dwells of 1e-07 to 1e-07 s"),
        (
            ("--aperture", "circle:20", "--dialect", "rapid", "--feed", 1e6),
            ProgramError,
            "a timed move takes 0.05 to 250",
        ),
        (("--aperture", "circle:20", "--dialect", "none"), ConfigError, "'none' is not known"),
        (("--cell", "nowhere.toml"), ConfigError, "nowhere.toml"),
    ],
)
def test_refusals_write_nothing(
    words: tuple[object, ...], error: type[PolishdError], what: str, tmp_path: Path
) -> None:
    said, files = refused(tmp_path, "raster", *words)
    assert isinstance(said, error)
    assert what in str(said)
    assert not files


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    said = call("raster", "--aperture", "circle:20", "--out", tmp_path / "nowhere" / "x.nc")
    assert isinstance(said.exception, ProgramError)
    assert "cannot be written" in str(said.exception)


@pytest.mark.full
def test_what_the_page_says_runs(polishd: Polishd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (EXAMPLE.parents[1] / "docs" / "how-to" / "paths.md").read_text()
    commands = page.split("```")[1].replace("\\\n", " ").strip().split("\n")
    (tmp_path / "cell.toml").write_text(EXAMPLE.read_text())
    monkeypatch.chdir(tmp_path)
    for command in commands:
        words = command.split()
        assert words.pop(0) == "polishd"
        said = polishd(*words, "--json").answer
        assert said["points"] > 5000
        text = (tmp_path / said["out"]).read_bytes()
        assert read(dialect(said["dialect"]), text, said["out"]).n == said["points"]
    assert len(commands) == 4
    for option in ("aperture", "optic", "pitch", "direction", "inwards", "overrun", "dip", "turn-limit", "encoding"):
        assert f"--{option}" in page


def test_a_cells_own_dialect_is_found_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "shop.toml").write_text('extends = "fanuc"\nname = "shop"\n')
    config = load_config(EXAMPLE)
    own = config.program.model_copy(update={"format": "shop", "dialects": (str(tmp_path / "shop.toml"),)})
    assert dialect_of(config.model_copy(update={"program": own})) == str(tmp_path / "shop.toml")
    other = own.model_copy(update={"format": "haas"})
    assert dialect_of(config.model_copy(update={"program": other})) == "haas"
    assert dialect_of(config) == "rs274"


def test_a_dialect_of_ones_own_is_said_by_name(tmp_path: Path) -> None:
    (tmp_path / "shop.toml").write_text('extends = "fanuc"\nname = "shop"\n')
    said, program = made(tmp_path, "spiral", "--aperture", "circle:9", to=str(tmp_path / "shop.toml"))
    assert said["dialect"] == program.dialect == "shop"


def test_the_cell_is_not_written_over(tmp_path: Path) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_bytes(EXAMPLE.read_bytes())
    said = call("spiral", "--cell", cell, "--out", cell)
    assert isinstance(said.exception, ProgramError)
    assert cell.read_bytes() == EXAMPLE.read_bytes()


def test_an_existing_file_is_replaced_only_with_force(polishd: Polishd, tmp_path: Path) -> None:
    out = tmp_path / "made.nc"
    out.write_text("old")
    words = ("program", "make", "raster", "--aperture", "circle:9", "--out", out)
    said = polishd(*words, "--json")
    assert (said.failure, out.read_text()) == (3, "old")
    assert f"{out}: exists already; name another file, or say --force" in said.err
    assert polishd(*words, "--force").code == 0
    assert out.read_bytes().startswith(b"(raster")


def test_nothing_takes_the_place_of_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "made.nc")
    error, _ = refused(tmp_path, "spiral", "--aperture", "circle:9")
    assert "is no file" in str(error)
    assert (tmp_path / "made.nc").is_fifo()


@pytest.mark.parametrize(
    "words", [("concentric", "--phase", 0.5), ("random", "--seed", 2, "--radius", 3), ("raster", "--cross", 60)]
)
def test_paths_that_spread_the_ripple(words: tuple[object, ...], tmp_path: Path) -> None:
    said, program = made(tmp_path, *words, "--aperture", "circle:30", *OFF_AXIS)
    assert said["points"] == program.n
    ends = np.stack([program.start_mm[0], program.end_mm[-1]])
    assert (np.hypot(*ends[:, :2].T) >= 20 - 1e-3).all()
    np.testing.assert_allclose(program.end_mm[:, 2], sag_mm(OFF_AXIS_OPTIC, program.end_mm[:, :2]), atol=1e-4)


def test_an_adaptive_raster_follows_a_map(tmp_path: Path) -> None:
    side = (np.arange(80) - 39.5) * 0.5
    round_part = np.hypot(side[None, :], side[:, None]) <= 15
    map_file = tmp_path / "part.dat"
    map_file.write_bytes(pack(DatMap(np.where(round_part, 100 + 5 * side[None, :], np.nan), 0.5)))
    _, program = made(
        tmp_path, "adaptive", "--aperture", f"mask:{map_file}", "--removal", map_file, "--direction", 90
    )  # fmt: skip
    x = program.end_mm[np.hypot(*program.end_mm.T[:2]) < 14, 0]
    assert np.count_nonzero(x > 5) > 1.2 * np.count_nonzero(x < -5)


def test_a_map_without_a_lateral_scale_is_refused(tmp_path: Path) -> None:
    map_file = tmp_path / "part.dat"
    map_file.write_bytes(pack(DatMap(np.full((80, 80), 10.0), 0.0)))
    for words in (
        ("raster", "--aperture", f"mask:{map_file}"), ("adaptive", "--aperture", "circle:30", "--removal", map_file),
    ):  # fmt: skip
        error, files = refused(tmp_path, *words)
        assert isinstance(error, MapError)
        assert "has no lateral scale. Give --cell" in str(error)
        assert files == ["part.dat"]


def test_a_map_whose_pixels_are_not_square_is_resampled(tmp_path: Path) -> None:
    points = [(0.5 * x, y, x + 1) for x in range(61) for y in range(21)]
    map_file = tmp_path / "part.csv"
    map_file.write_text("x_mm,y_mm,z_nm\n" + "".join(f"{x:g},{y:g},{z:g}\n" for x, y, z in points))
    _, program = made(tmp_path, "raster", "--aperture", f"mask:{map_file}")
    half = np.abs(program.end_mm[:, :2]).max(axis=0)
    assert half[1] == pytest.approx(11, abs=1)
    made(tmp_path, "adaptive", "--aperture", "rectangle:30,20", "--removal", map_file)


def test_a_map_smaller_than_the_aperture_is_no_removal_of_it(tmp_path: Path) -> None:
    map_file = tmp_path / "part.dat"
    map_file.write_bytes(pack(DatMap(np.arange(6400.0).reshape(80, 80), 0.5)))
    for shape in ("adaptive", "random"):
        error, _ = refused(tmp_path, shape, "--aperture", "circle:60", "--removal", map_file)
        assert isinstance(error, MapError)
        assert "the map is 40 x 40 mm, smaller than the aperture of 60 x 60 mm" in str(error)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("adaptive",), "adaptive needs --removal"),
        (("spiral", "--cross", 90), "--cross goes with raster, not with spiral"),
        (("raster", "--seed", 3), "--seed goes with random, not with raster"),
        (("random", "--phase", 0.5), "--phase goes with raster, spiral, concentric, not with random"),
    ],
)
def test_options_of_another_shape(words: tuple[object, ...], what: str, tmp_path: Path) -> None:
    said = call(*words, "--aperture", "circle:30", "--out", tmp_path / "made.nc")
    assert said.exit_code == 2
    assert what in " ".join(said.output.replace("\u2502", " ").split())


def test_a_spot_wider_than_the_part(tmp_path: Path) -> None:
    error, files = refused(tmp_path, "random", "--cell", EXAMPLE, "--aperture", "circle:3")
    assert "the spot's radius of 1.6" in str(error)
    assert not files


@pytest.mark.full
def test_the_programs_that_the_page_makes_for_two_passes_lie_between_each_other(
    polishd: Polishd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (EXAMPLE.parents[1] / "docs" / "how-to" / "paths.md").read_text().partition("## From pass to pass")[2]
    commands, keys = (block.strip() for block in page.split("```")[1:4:2])
    (line,) = [one for one in EXAMPLE.read_text().splitlines() if one.startswith('path = "program.rnc"')]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cell.toml").write_text(EXAMPLE.read_text().replace(line, keys.removeprefix("toml\n[program]\n")))
    for command in commands.splitlines():
        polishd(*command.split()[1:], "--json")
    cell = load_config(tmp_path / "cell.toml")
    programs = precheck.read_programs(cell, make_recipe(cell, load_own()))
    assert [program.name for program in programs] == ["program.rnc", "between.rnc"]
    first, second = (
        np.unique(np.round(program.end_mm[np.abs(program.end_mm[:, 0]) < 20, 1], 3)) for program in programs
    )
    apart = np.abs(second[:, None] - first).min(axis=1)
    assert apart == pytest.approx(np.full(second.size, np.diff(first).mean() / 2), abs=0.01)
