"""The keys of [part] that say its outline: one of them, valid alone, with the location of an error."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.config.cell import CellConfig, load_config
from polishd.config.job_file import JobFile
from polishd.config.simulator_physics import Plant
from polishd.model.errors import ConfigError
from polishd.model.outline import Circle, Outline, hexagon, polygon, rectangle

EXAMPLE = Path(__file__).parents[3] / "examples" / "cell.toml"
ROUND = "aperture_mm = 100.0\n"
CORNERS = ((20.0, 10.0), (-20.0, 10.0), (-20.0, -10.0), (10.0, -12.0))


def cell(folder: Path, said: str, more: str = "") -> CellConfig:
    text = EXAMPLE.read_text()
    assert text.count(ROUND) == 1
    (folder / "cell.toml").write_text(text.replace(ROUND, f"{said}\n{more}"))
    return load_config(folder / "cell.toml")


@pytest.mark.parametrize(
    ("said", "outline"),
    [
        (ROUND, Circle(50.0)),
        ("aperture_mm = 100.0\nhole_mm = 40.0", Circle(50.0, 20.0)),
        ("rectangle_mm = [40.0, 24]", rectangle(40, 24)),
        ("hexagon_mm = 30", hexagon(30)),
        (f"polygon_mm = {[list(corner) for corner in CORNERS]}", polygon(CORNERS)),
        ('polygon_file = "corners.csv"', polygon(CORNERS)),
    ],
)
def test_one_key_says_the_outline(tmp_path: Path, said: str, outline: Outline) -> None:
    (tmp_path / "corners.csv").write_text("y_mm,x_mm\n" + "".join(f"{y},{x}\n" for x, y in CORNERS))
    assert cell(tmp_path, said).outline() == outline


@pytest.mark.parametrize(
    ("said", "says"),
    [
        (
            "rectangle_mm = [40.0, 24.0]\naperture_mm = 30.0",
            "part.rectangle_mm: aperture_mm defines the part's outline",
        ),
        ("rectangle_mm = [40.0, -1]", "part.rectangle_mm: -1 is out of range; must be at least 0.1"),
        ("rectangle_mm = [40.0, 24.0]\nhole_mm = 5.0", "part.hole_mm: needs aperture_mm, not rectangle_mm"),
        ("aperture_mm = 100.0\nhole_mm = 100.0", "part.hole_mm: the outline's hole is 100 mm wide; it must be less"),
        (
            "aperture_mm = 100.0\nhole_mm = 94.0",
            "part.edge_mm: no clear aperture is left: the part's center is 1.5 mm",
        ),
        ("rectangle_mm = 40.0", "part.rectangle_mm: must be a list [...], not 40.0"),
        ("hexagon_mm = 0", "part.hexagon_mm: 0 is out of range"),
        ("polygon_mm = [[1, 1], [-1, 1]]", "part.polygon_mm: a polygon has 3 to 500 corners, not 2"),
        ("polygon_mm = [[9, 9], [-9, -9], [9, -9], [-9, 9]]", "part.polygon_mm: the sides of the polygon that begin"),
        (
            "polygon_mm = [[9, 9], [1, 9], [1, 1], [9, 1]]",
            "part.polygon_mm: the part's center, x 0 and y 0, lies outside",
        ),
        (
            "rectangle_mm = [40.0, 6.0]",
            "part.edge_mm: no clear aperture is left: the part's center is 3 mm from its rim",
        ),
        (
            "hexagon_mm = 30\ncurvature_radius_mm = 17.0",
            "part.curvature_radius_mm: 17 mm is too small for an aperture of 34.641 mm",
        ),
        ('polygon_file = "none.csv"', "part.polygon_file: "),
    ],
)
def test_what_is_wrong_is_said_with_its_place(tmp_path: Path, said: str, says: str) -> None:
    with pytest.raises(ConfigError) as error:
        cell(tmp_path, said).outline()
    assert says in str(error.value)
    assert str(error.value).startswith(f"{tmp_path}/cell.toml:")
    assert "\n" not in str(error.value)


def test_what_a_file_of_corners_has_wrong_is_said_with_its_line(tmp_path: Path) -> None:
    config = cell(tmp_path, 'polygon_file = "corners.csv"')
    for content, says in (
        ("x_mm,y_mm\n9,9\n-9,9\nx,-9\n", f"part.polygon_file: {tmp_path}/corners.csv:4: x_mm is 'x'"),
        ("x_mm,y_mm\n9,9\n1,9\n1,1\n9,1\n", "part.polygon_file: the part's center, x 0 and y 0, lies outside"),
        ("x_mm,y_mm\n9,2\n-9,2\n-9,-2\n9,-2\n", "part.edge_mm: no clear aperture is left"),
    ):
        (tmp_path / "corners.csv").write_text(content)
        with pytest.raises(ConfigError) as error:
            config.outline()
        assert says in str(error.value)


def test_a_jobs_outline_takes_the_place_of_the_cells(tmp_path: Path) -> None:
    config = cell(tmp_path, "rectangle_mm = [40.0, 24.0]")
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs" / "corners.csv").write_text("x_mm,y_mm\n" + "".join(f"{x},{y}\n" for x, y in CORNERS))
    for said, outline in (
        ("aperture_mm = 60.0", Circle(30.0)),
        ('polygon_file = "corners.csv"', polygon(CORNERS)),
        ("", rectangle(40, 24)),
    ):
        file = tmp_path / "jobs" / "job.toml"
        file.write_text(f'[job]\nid = "j"\n[part]\nid = "L-7"\n{said}\n')
        assert JobFile.read(file).laid_over(config).outline() == outline


def test_a_simulated_part_is_round_unless_another_key_says_it() -> None:
    assert Plant().outline == Circle(50.0)
    assert Plant(rectangle_mm=(40.0, 24.0)).outline == rectangle(40, 24)
    with pytest.raises(ValueError, match="aperture_mm defines the part's outline already"):
        Plant(aperture_mm=30.0, hexagon_mm=30.0)
