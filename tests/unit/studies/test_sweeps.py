"""Sweeps from their file to their table, also of a study that is killed: rows, refusals, and what is shown."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from polishd.config.sweep import load_swept
from polishd.model.errors import ConfigError
from polishd.rendering.terminal import stdout
from polishd.studies.cases import cases_of
from polishd.studies.options import StudyOptions
from polishd.studies.result_store import JOURNAL, TABLE, read_table
from polishd.studies.run import show_verb, study_verb
from tests.unit.studies.studies import EXAMPLES, FIG_12, TABLE_III, small, variant
from tests.unit.studies.test_case_runner import LOOPS, NONE, study_file

TIMES = ("wall_s", "cpu_s", "tries")
FORCES = '\n[[sweep.group]]\nover."process.force_n" = { linear = [8.0, 14.0], count = 4 }\n'
KILLED = """
import os, signal, sys
from pathlib import Path
from polishd.studies import result_store as kept
from polishd.studies.options import StudyOptions
from polishd.studies.run import study_verb
add, seen = kept.ResultStore.add, []
def then_die(self, done):
    seen.append(add(self, done))
    if len(seen) == 2:
        os.kill(os.getpid(), signal.SIGKILL)
kept.ResultStore.add = then_die
study_verb(Path(sys.argv[1]), StudyOptions(out=Path(sys.argv[2]), workers=1), as_json=True)
"""


def few(folder: Path) -> Path:
    """Passes over a small part, at four forces."""
    path = variant(folder, FIG_12, ("aperture_mm = 200.0", "aperture_mm = 40.0"))
    path.write_text(path.read_text() + FORCES)
    return path


def table(folder: Path) -> list[dict[str, Any]]:
    rows, _ = read_table(folder)
    return [{key: value for key, value in row.items() if key not in TIMES} for row in rows]


@pytest.mark.full
def test_a_killed_study_goes_on_and_has_the_same_table(tmp_path: Path) -> None:
    study, whole, killed = few(tmp_path), tmp_path / "whole", tmp_path / "killed"
    study_verb(study, StudyOptions(out=whole, workers=1), as_json=True)
    killed.mkdir()
    ended = subprocess.run([sys.executable, "-c", KILLED, str(study), str(killed)], check=False, capture_output=True)
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    assert len((killed / JOURNAL).read_text().splitlines()) == 2
    assert not (killed / TABLE).exists()
    study_verb(study, StudyOptions(out=killed, workers=1), as_json=True)
    assert table(killed) == table(whole)
    assert [row["over.process.force_n"] for row in table(whole)] == [8.0, 10.0, 12.0, 14.0]
    assert not (killed / JOURNAL).exists()
    study_verb(study, StudyOptions(out=killed, limit=1), as_json=True)
    assert table(killed) == table(whole), "who asks for less takes nothing away"


@pytest.mark.full
def test_corrections_are_compared_on_the_same_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = small(tmp_path)
    study.write_text(study.read_text() + '\n[[sweep.group]]\nover."surface.seed" = [1, 2]\n')
    study_verb(study, StudyOptions(out=tmp_path / "out", workers=2), as_json=True)
    found = json.loads(capsys.readouterr().out)
    assert found["rows"] == 2 * 2 * 6
    paired = next(one for one in found["paired"] if one["label"] == {"plant": "depth", "correction": "exact"})
    assert (paired["against"], paired["figure"], paired["pairs"], paired["lower"]) == ("none", "rms_nm", 2, 2)


@pytest.mark.full
def test_spots_have_a_row_a_reading(tmp_path: Path) -> None:
    study = variant(tmp_path, TABLE_III)
    study.write_text(study.read_text() + "\n[[sweep.group]]\nover.seconds = [30.0, 60.0]\n")
    study_verb(study, StudyOptions(out=tmp_path / "out", workers=1), as_json=True)
    rows = table(tmp_path / "out")
    assert len(rows) == 2 * 12
    by = {(row["over.seconds"], row["name"], row["size_is"]): row["volume_mm3"] for row in rows}
    assert by[60.0, "1", "radius"] == pytest.approx(2 * by[30.0, "1", "radius"])


@pytest.mark.full
def test_loops_are_shown_with_what_was_swept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rates = '\n[[sweep.group]]\nover."plant_with.hidden_truth.stiffness" = [0.0, 0.1, 0.3]\n'
    study, out = study_file(tmp_path, f"{LOOPS}{NONE}{rates}", near=-0.1), tmp_path / "out"
    study_verb(study, StudyOptions(out=out, limit=4), as_json=True)
    assert len(table(out)) == 4
    study_verb(study, StudyOptions(out=out), as_json=True)
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [group["label"] for group in found["groups"]] == [{"loop": "exact"}, {"loop": "none"}]
    assert [group["cases"] for group in found["groups"]] == [3, 3]
    show_verb(out, as_json=True)
    assert json.loads(capsys.readouterr().out) == found
    show_verb(out, as_json=False)
    said = " ".join(capsys.readouterr().out.split())
    assert "on the same draws" in said
    assert "rank correlation of true_rms_end_nm" in said
    for name in ("medians.png", "sensitivity.png", "fails.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")


REFUSED = {
    'over."plant_with.hidden_truth.drft" = [0.1]': "plant_with.hidden_truth.drft: unknown key; did you mean 'drift'?",
    'over."plant_with.effects.eq_44" = [[0.5, 2.0]]': "plant_with.effects.eq_44: [0.5, 2] is no range within 0 to 1",
    'over."cell_with.process.forc_n" = [12.0]': "cell_with.process.forc_n: unknown key; did you mean 'force_n'?",
    'over."controllers.exact.process.force_n" = [900.0]': "controllers.exact.process.force_n: 900.0 is out of range",
    'over."controllers.exact.learns" = [3]': "controllers.exact.learns: must be true or false",
    'over."controllers.other.process.rpm" = [12.0]': "controllers.other.process.rpm: the study has no loop 'other'",
}


@pytest.mark.parametrize(("group", "said"), REFUSED.items())
def test_a_case_that_cannot_be_is_refused_before_any_runs(tmp_path: Path, group: str, said: str) -> None:
    path = study_file(tmp_path, f"{LOOPS}\n[[sweep.group]]\n{group}\n", near=-0.1)
    line = path.read_text().splitlines().index(group) + 1
    with pytest.raises(ConfigError, match=rf"^{re.escape(f'{path}:{line}: sweep.group.over.{said}')}"):
        cases_of(load_swept(path))


def test_a_missing_file_is_reported_at_its_key_and_out_is_not_created(tmp_path: Path) -> None:
    path, out = study_file(tmp_path, LOOPS, near=-0.1), tmp_path / "out"
    whole = path.read_text()
    for wrong in ('cell = "no.toml"', 'plant = "no.toml"', 'scenarios = ["no.toml"]'):
        key = wrong.partition(" ")[0]
        lines = [wrong if line.startswith(f"{key} =") else line for line in whole.splitlines()]
        path.write_text("\n".join(lines))
        said = f"{path}:{lines.index(wrong) + 1}: {key}: {tmp_path / 'no.toml'}: no such file"
        with pytest.raises(ConfigError, match=rf"^{re.escape(said)}"):
            study_verb(path, StudyOptions(out=out), as_json=True)
    group = 'over."cell" = ["no.toml"]'
    path.write_text(f"{whole}\n[[sweep.group]]\n{group}\n")
    line = path.read_text().splitlines().index(group) + 1
    with pytest.raises(ConfigError, match=rf"^{re.escape(f'{path}:{line}: sweep.group.over.cell: ')}"):
        study_verb(path, StudyOptions(out=out), as_json=True)
    assert not out.exists()


def test_who_watches_a_cell_decides_no_case(tmp_path: Path) -> None:
    """Or a study would begin anew because a page's port is another one."""
    path = study_file(tmp_path, LOOPS, near=-0.1)

    def of(key: str) -> str:
        path.write_text(path.read_text().partition("[controllers.exact]")[0] + f"{LOOPS}{key}\n")
        return cases_of(load_swept(path))[0].of

    assert of('"web.port" = 9000') == of("")
    assert of('"process.rpm" = 900.0') != of("")


@pytest.mark.full
def test_rows_that_are_not_reused_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study, out = few(tmp_path), tmp_path / "out"
    study_verb(study, StudyOptions(out=out, workers=1, limit=2), as_json=True)
    study_verb(study, StudyOptions(out=out, workers=1, limit=2), as_json=True)
    assert "are not taken" not in capsys.readouterr().err
    study.write_text(study.read_text().replace("linear = [8.0, 14.0]", "linear = [8.0, 17.0]"))
    study_verb(study, StudyOptions(out=out, workers=1, limit=2), as_json=True)
    assert f"{out}: 1 cases there are of other files, keys or versions than now" in capsys.readouterr().err


@pytest.mark.full
def test_the_shipped_study_has_two_thousand_jobs_on_the_same_draws() -> None:
    cases = cases_of(load_swept(EXAMPLES / "robustness.toml"))
    assert len(cases) == 2200
    assert len({case.of for case in cases}) == 2200
    assert [case.loop for case in cases[:10]] == [case.loop for case in cases[10:20]]
    assert {json.dumps(dict(case.at)) for case in cases[:10]} == {json.dumps(dict(cases[0].at))}


@pytest.mark.full
def test_failures_are_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(stdout, "_width", 200)
    study, out = few(tmp_path), tmp_path / "out"
    two = 'over."process.tool_modulus_mpa" = [4.0, 2960.0]'
    study.write_text(study.read_text().replace(FORCES.splitlines()[-1], two))
    study_verb(study, StudyOptions(out=out, workers=1), as_json=False)
    said = capsys.readouterr().out
    assert "1 of 2 cases have an error instead of figures" in said
    assert "gamma would not be above 0" in said
    assert [bool(row["error"]) for row in table(out)] == [False, True]
