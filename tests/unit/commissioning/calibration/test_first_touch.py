"""``polishd calibrate first-touch``: the files that it leaves, and what it refuses."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from polishd.commissioning.calibration.first_touch import TouchOptions, touch_verb
from polishd.config.cell import load_config
from polishd.config.job_file import JobFile
from polishd.model.errors import ComputeError, ConfigError
from tests.unit.studies.studies import TABLE_III

EXAMPLES = TABLE_III.parent
OPTIONS = TouchOptions("W-1", 20.0, {})


def cell_in(folder: Path, *changes: tuple[str, str]) -> Path:
    text = (EXAMPLES / "cell.toml").read_text()
    for old, new in (
        ("[process]", '[process]\nestimates = "machine"'),
        ("aperture_mm = 100", "aperture_mm = 30"),
        *changes,
    ):
        assert old in text
        text = text.replace(old, new, 1)
    for name in ("instrument.toml", "sim.toml"):
        (folder / name).write_text((EXAMPLES / name).read_text())
    path = folder / "cell.toml"
    path.write_text(text)
    return path


@pytest.mark.full
def test_a_job_and_a_fragment_run_the_touch(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell, out = cell_in(tmp_path), tmp_path / "touch"
    touch_verb(cell, out, OPTIONS, as_json=True)
    shown = json.loads(capsys.readouterr().out)
    assert shown == json.loads((out / "touch.json").read_text())
    assert {path.name for path in out.iterdir()} == {
        "touch.rnc",
        "job.toml",
        "fragment.toml",
        "touch.png",
        "touch.json",
    }
    rate = next(row for row in shown["parameters"] if row["name"] == "rate")
    assert 0.0 < rate["after"] < 0.2 * rate["before"]
    queued = JobFile.read(out / "job.toml").laid_over(load_config(cell))
    cell.write_text(f'include = ["touch/fragment.toml"]\n{cell.read_text()}')
    for config in (queued, load_config(cell)):
        assert config.program_path.resolve() == (out / "touch.rnc").resolve()
        assert (config.part.id, config.dwell.objective, config.job.max_cycles) == ("W-1", "as_programmed", 1)
    with pytest.raises(ConfigError, match="exists already"):
        touch_verb(cell, out, OPTIONS, as_json=True)


@pytest.mark.full
def test_ways_between_the_tracks_count(tmp_path: Path) -> None:
    with pytest.raises(
        ComputeError, match=r"the touch takes \d\.\d min, \d\.\d of them from track to track, and 0\.1 are"
    ):
        touch_verb(cell_in(tmp_path), tmp_path / "touch", TouchOptions("W", 0.15, {}), as_json=True)
    assert not (tmp_path / "touch").exists()


@pytest.mark.parametrize(
    ("changes", "options", "said"),
    [
        (
            (('estimates = "machine"', 'estimates = "rate"'),),
            OPTIONS,
            r"cell.toml:\d+: process.estimates: is not \"machine\"",
        ),
        ((("aperture_mm = 30", "aperture_mm = 12"),), OPTIONS, "no room for tracks"),
        ((), TouchOptions("W", 20.0, {"speed": 1.0}), "--want speed: no such parameter; there are compliance"),
        ((), TouchOptions("W", 20.0, {"rate": 0.0}), "--want rate=0: must be above 0"),
        ((), TouchOptions("W", 20.0, {"wear": 0.1}), "--want wear: a touch cannot estimate it"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_written(
    tmp_path: Path, changes: tuple[tuple[str, str], ...], options: TouchOptions, said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        touch_verb(cell_in(tmp_path, *changes), tmp_path / "touch", options, as_json=True)
    assert not (tmp_path / "touch").exists()


def test_files_are_toml(tmp_path: Path) -> None:
    from polishd.commissioning.calibration.first_touch import JOB_TEXT

    assert tomllib.loads(JOB_TEXT.format(use="x", part="P", program="a.rnc"))["program"]["coverage"] == "zone"
