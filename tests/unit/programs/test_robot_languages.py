"""One program in each robot language: made, rewritten with a random dwell, read back, converted and converted back."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from polishd.cli.program import make
from polishd.model.program import Encoding, Program
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.dialect import LANGUAGES, dialect
from polishd.plugins.rnc_robot.languages import LanguageProfile
from polishd.plugins.rnc_robot.verify import verify
from polishd.programs.rewrite import DwellTable, read_program_file, rewrite_file
from tests.unit.plugins.rnc_robot.test_fuzz import language_strayed

app = typer.Typer()
app.command()(make)


def made(folder: Path, profile: LanguageProfile, encoding: str) -> Path:
    out = folder / f"made-{encoding}.txt"
    options = ["raster", "--aperture", "circle:8", "--pitch", "2", "--step", "2", "--feed", "1500", "--out", str(out)]
    options += ["--dialect", profile.name, "--encoding", encoding]
    options += ["--dwell", "0.2"] if encoding == "wait" else []
    said = CliRunner().invoke(app, options)
    assert said.exit_code == 0, (said.output, said.exception)
    return out


def rewritten(
    path: Path, profile: LanguageProfile, times: FloatArray, name: str, encoding: Encoding | None = None
) -> tuple[Path, Program]:
    """The file with these times, proved to move as before, and what reads back of it."""
    table, out = path.with_name("dwell.csv"), path.with_name(f"{name}.txt")
    table.write_text("\n".join(map(str, times.tolist())))
    rewrite_file(path, DwellTable(table), out, profile, encoding)
    proof = verify(path, out, profile)
    assert proof.identical_motion, proof.difference
    return out, read_program_file(profile, out)


def resolved(found: Program, wanted: FloatArray, profile: LanguageProfile) -> None:
    """Each time within its resolution, and the sum within that of one."""
    rules = profile.move_time
    assert rules is not None
    if found.encoding == "dwell":
        step = np.full(found.n, profile.dwell.quantum_s)
    elif found.encoding == "time":
        step = np.full(found.n, rules.quantum_s)
    else:
        unit_mm_s = rules.speed_quantum * profile.feed_units_mm_min[rules.speed_unit] / 60
        step = unit_mm_s / (found.length_mm / wanted) * wanted
    own = step / 2 + step.max() / 2  # its rounding, and what rounding left before
    assert (np.abs(found.time_s - wanted) <= own * 1.02 + 1e-9).all()
    assert abs(math.fsum(found.time_s) - math.fsum(wanted)) <= step.max() + 1e-9


def drawn(name: str, number: int) -> FloatArray:
    return np.random.default_rng(list(name.encode())).uniform(0.06, 0.2, number)


@pytest.mark.parametrize("encoding", ["feed", "time", "wait"])
@pytest.mark.parametrize("name", sorted(LANGUAGES))
def test_a_program_is_made_rewritten_and_read_back(name: str, encoding: str, tmp_path: Path) -> None:
    profile = dialect(name)
    assert isinstance(profile, LanguageProfile)
    assert profile.move_time is not None
    if encoding == "time" and not profile.move_time.time:
        return
    path = made(tmp_path, profile, encoding)
    program = read_program_file(profile, path)
    wanted = drawn(name, program.n)
    out, found = rewritten(path, profile, wanted, "new")
    resolved(found, wanted, profile)
    np.testing.assert_array_equal(found.end_mm, program.end_mm)
    np.testing.assert_array_equal(found.axis, program.axis)
    assert language_strayed(program, out.read_bytes()) == []


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", sorted(LANGUAGES))
def test_times_go_from_speeds_to_waits_and_back(name: str, tmp_path: Path) -> None:
    profile = dialect(name)
    assert isinstance(profile, LanguageProfile)
    waits = made(tmp_path, profile, "wait")  # whose moves stop
    wanted = drawn(name, read_program_file(profile, waits).n)
    feeds, program = rewritten(waits, profile, wanted, "feeds", "feed")
    assert program.encoding == "feed"
    resolved(program, wanted, profile)
    waiting, found = rewritten(feeds, profile, program.time_s, "waits", "dwell")
    assert found.encoding == "dwell"
    resolved(found, program.time_s, profile)
    back, again = rewritten(waiting, profile, program.time_s, "back", "feed")
    np.testing.assert_allclose(again.time_s, program.time_s, rtol=1e-9)
    assert back.read_bytes() == feeds.read_bytes()
