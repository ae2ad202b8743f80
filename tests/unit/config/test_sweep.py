"""`[sweep]` of a study's file: its points, and what is refused, with file, line and key, before anything runs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.config.study import CorrectionsStudy
from polishd.config.sweep import load_swept, location_of, put
from polishd.model.errors import ConfigError
from tests.unit.studies.studies import SMALL, TABLE_IV, variant

HEAD = "\n[sweep]\nseed = 3\n"


def study(folder: Path, *groups: str) -> Path:
    """Table IV with these groups at its end."""
    path = variant(folder, TABLE_IV, *SMALL)
    path.write_text(path.read_text() + HEAD + "".join(f"\n[[sweep.group]]\n{group}" for group in groups))
    return path


def points(folder: Path, *groups: str) -> list[Any]:
    return list(load_swept(study(folder, *groups)).points)


def column(folder: Path, axis: str, how: str = 'how = "latin"\ndraws = 200') -> np.ndarray:
    """The values that a key of a group with this axis takes."""
    found = points(folder, f'{how}\n[sweep.group.over]\n"process.force_n" = {axis}')
    return np.array([point["process.force_n"] for point in found])


def test_a_study_without_a_sweep_is_one_point(tmp_path: Path) -> None:
    swept = load_swept(TABLE_IV)
    assert swept.points == ({},)
    assert not swept.is_sweep


def test_lists_and_ranges_are_crossed_and_groups_too(tmp_path: Path) -> None:
    found = points(
        tmp_path,
        '[sweep.group.over]\n"process.force_n" = [10.0, 12.0]\n'
        '"process.dip_deg" = { linear = [10.0, 20.0], count = 3 }',
        '[sweep.group.over]\n"process.rpm" = { log = [100.0, 10000.0], count = 3 }',
    )
    assert len(found) == 2 * 3 * 3
    assert found[0] == pytest.approx({"process.force_n": 10.0, "process.dip_deg": 10.0, "process.rpm": 100.0})
    assert found[1]["process.rpm"] == pytest.approx(1000.0)
    assert found[-1] == pytest.approx({"process.force_n": 12.0, "process.dip_deg": 20.0, "process.rpm": 10000.0})


def test_zipped_keys_go_side_by_side(tmp_path: Path) -> None:
    found = points(tmp_path, 'how = "zipped"\nover."process.force_n" = [10.0, 12.0]\nover."surface.seed" = [4, 5]')
    assert found == [
        {"process.force_n": 10.0, "surface.seed": 4},
        {"process.force_n": 12.0, "surface.seed": 5},
    ]


def test_each_point_is_a_study_of_its_own(tmp_path: Path) -> None:
    swept = load_swept(study(tmp_path, 'over."process.force_n" = [10.0, 12.5]'))
    second = swept.at(swept.points[1])
    assert isinstance(second, CorrectionsStudy)
    assert second.process.force_n == 12.5
    assert swept.at(swept.points[0]).process.force_n == 10.0  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("axis", "middle", "low", "high"),
    [
        ("{ uniform = [10.0, 20.0] }", 15.0, 10.0, 20.0),
        ("{ log_uniform = [4.0, 100.0] }", 20.0, 4.0, 100.0),
        ("{ normal = [12.0, 1.0] }", 12.0, 7.0, 17.0),
        ("{ lognormal = [12.0, 0.1] }", 12.0, 7.0, 20.0),
    ],
)
def test_a_latin_hypercube_covers_each_distribution_evenly(
    tmp_path: Path, axis: str, middle: float, low: float, high: float
) -> None:
    values = column(tmp_path, axis)
    assert np.median(values) == pytest.approx(middle, rel=0.01)
    assert values.min() >= low
    assert values.max() <= high
    assert len(set(values)) == 200


def test_one_value_in_each_of_equal_parts(tmp_path: Path) -> None:
    values = column(tmp_path, "{ uniform = [10.0, 20.0] }")
    assert sorted(np.floor((values - 10.0) * 20.0)) == list(range(200))


def test_draws_are_of_the_seed_and_plain_draws_are_not_even(tmp_path: Path) -> None:
    drawn = 'how = "drawn"\ndraws = 200'
    first = column(tmp_path, "{ uniform = [10.0, 20.0] }", drawn)
    assert np.array_equal(first, column(tmp_path, "{ uniform = [10.0, 20.0] }", drawn))
    assert len(set(np.floor((first - 10.0) * 20.0))) < 200


def test_lists_are_drawn_from_and_numbers_go_on(tmp_path: Path) -> None:
    group = (
        'how = "latin"\ndraws = 6\nover."process.force_n" = [10.0, 12.0]\nover."surface.seed" = { numbers_from = 5 }'
    )
    found = points(tmp_path, group)
    assert [point["surface.seed"] for point in found] == [5, 6, 7, 8, 9, 10]
    assert sorted(point["process.force_n"] for point in found) == [10.0] * 3 + [12.0] * 3


def test_a_pair_is_a_range_of_no_width(tmp_path: Path) -> None:
    axis = "{ uniform = [30.0, 60.0], pair = true }"
    path = study(tmp_path, f'how = "drawn"\ndraws = 2\nover."surface.period_mm" = {axis}')
    with pytest.raises(ConfigError, match=r"sweep\.group\.over\.surface\.period_mm: .* is not a range"):
        load_swept(path)


def test_files_are_found_from_the_studys_folder(tmp_path: Path) -> None:
    for name in ("b.dat", "a.dat", "c.txt"):
        (tmp_path / name).write_bytes(b"")
    no_map = (("rms_nm = 18.5", 'file = "a.dat"'), ("period_mm = [33.0, 120.0]", ""))
    path = variant(tmp_path, TABLE_IV, *no_map)
    path.write_text(f'{path.read_text()}{HEAD}\n[[sweep.group]]\nover."surface.file" = {{ files = "*.dat" }}\n')
    assert load_swept(path).points == ({"surface.file": "a.dat"}, {"surface.file": "b.dat"})


def test_keys_of_loops_have_dots_of_their_own() -> None:
    assert location_of("cell_with.process.force_n") == ("cell_with", "process.force_n")
    assert location_of("controllers.exact.process.force_n") == ("controllers", "exact", "process.force_n")
    assert location_of("plant_with.hidden_truth.rate") == ("plant_with", "hidden_truth", "rate")
    raw: dict[str, Any] = {"cell_with": {"a": 1}}
    put(raw, "cell_with.process.force_n", 12.0)
    assert raw == {"cell_with": {"a": 1, "process.force_n": 12.0}}
    with pytest.raises(ConfigError, match="'title' is not a section"):
        put({"title": "t"}, "title.x", 1)


REFUSED = {
    'over."process.forc_n" = [12.0]': "process.forc_n: unknown key; did you mean 'force_n'?",
    'over."odd.key" = [12.0]': "odd.key: unknown key",
    'over."process.force_n" = []': "process.force_n: is empty; give at least one value",
    'over."process.force_n" = { uniform = [2.0, 2.0] }': "process.force_n.uniform: [2.0, 2.0] is not a range",
    'over."process.force_n" = ["x"]': "process.force_n: must be a number, not the string 'x'",
    'over."process.force_n" = [12.0, 900.0]': "process.force_n: 900.0 is out of range; must be at most 500.0",
    'over."process.force_n" = { uniform = [2.0, 3.0] }': "process.force_n: uniform needs draws",
    'over."process.force_n" = { linear = [2.0, 3.0] }': "linear and log need count",
    'over."process.force_n" = { linear = [2.0, 3.0], count = 2, values = [1.0] }': "has values and linear; give one of",
    'over."process.force_n" = { log = [0.0, 3.0], count = 2 }': "log starts at 0",
    'over."process.force_n" = { lognormal = [0.0, 1.0] }': "the median of lognormal is 0; it must be above 0",
    'over."process.force_n" = { normal = [12.0, 0.0] }': "the standard deviation of normal is 0; it must be above 0",
    'over."process.force_n" = { odd = 1 }': "unknown key",
    'over."surface.file" = { files = "maps/*.dat" }': "surface.file: maps/*.dat: no file",
    'over."kind" = ["spots"]': "kind: is the same for all cases",
    'how = "drawn"\nover."process.force_n" = [12.0]': "draws: is missing",
    'draws = 3\nover."process.force_n" = [12.0]': "draws: ",
    'how = "zipped"\nover."process.force_n" = [1.0, 2.0]\nover."process.rpm" = [1.0]': "process.rpm: has 1 values, and",
    'how = "odd"\nover."process.force_n" = [12.0]': "how: 'odd' is not allowed",
    'over."process.force_n" = 3': "process.force_n: must have several values, not 3",
    'over."process.force_n" = [nan]': "process.force_n: nan is not allowed; must be a finite number",
    'over."process.force_n" = { normal = [12.0, -0.5] }': "standard deviation of normal is -0.5; it must be above 0",
    'over."controllers.other.process.force_n" = [12.0]': "the study has no loop 'other', only none",
    "over = {}": "over: has 0 entries",
}


@pytest.mark.parametrize(("group", "said"), REFUSED.items())
def test_what_cannot_be_is_refused_at_its_line(tmp_path: Path, group: str, said: str) -> None:
    path = study(tmp_path, group)
    lines = path.read_text().splitlines()
    with pytest.raises(ConfigError, match=re.escape(said)) as caught:
        load_swept(path)
    place = re.match(rf"{re.escape(str(path))}:(\d+): sweep\.", str(caught.value))
    assert place, str(caught.value)
    assert int(place[1]) > lines.index("[sweep]")


def test_what_a_point_cannot_be_as_a_whole_says_for_which_point(tmp_path: Path) -> None:
    path = study(tmp_path, 'over."path.step_mm" = [1.0, 0.001]')
    with pytest.raises(ConfigError, match=r"path: .* can be computed \(with path\.step_mm = 0\.001\)"):
        load_swept(path)


def test_a_key_twice_and_too_many_points_are_refused(tmp_path: Path) -> None:
    twice = 'over."process.force_n" = [12.0]'
    with pytest.raises(ConfigError, match=r"process\.force_n: is swept by another group, too"):
        points(tmp_path, twice, twice)
    many = [f'over."process.{key}" = {{ linear = [1.0, 9.0], count = 400 }}' for key in ("force_n", "rpm")]
    with pytest.raises(ConfigError, match="has 160000 points; at most 100000"):
        points(tmp_path, *many)
