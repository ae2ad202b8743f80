"""docs/how-to/upgrade.md: what version 0.1 left is read as it is, converted without a loss; its files name new keys."""

from __future__ import annotations

import hashlib
import json
import re
import sqlite3
import tarfile
import tomllib
from contextlib import closing
from pathlib import Path

import pytest

from polishd.config.cell import load_config
from polishd.config.instrument_profile import load_profile
from polishd.daemon.job.initial_estimates import journalled_estimates
from polishd.daemon.journal.history import read_events, read_history, read_only
from polishd.daemon.journal.journal import ARRAYS_NAME, JOURNAL_NAME, Journal
from polishd.daemon.journal.store import SCHEMA_VERSION, old_copy
from polishd.daemon.queue.queue import Queue
from polishd.daemon.queue.requests import require_unchanged
from polishd.daemon.runtime.exit_record import last_ending
from polishd.model.errors import ConfigError
from polishd.plugin_loader import plugins_of
from polishd.plugins.interferometer.map_files import TakenMaps
from polishd.reports.certificate.sources import read_rows
from tests.unit.cli_result import Polishd

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "upgrade.md").read_text()
TABLES = ("job", "map", "phase", "pass", "segment", "event", "queue")
RENAMED = re.compile(r"\.toml:(\d+): (\S+): was renamed: write (\S+)")


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """The cell of version 0.1."""
    with tarfile.open(ROOT / "tests" / "data" / "cell_0_1.tar.xz") as packed:
        packed.extractall(tmp_path, filter="data")
    return tmp_path / "cell_0_1"


def counts(path: Path) -> dict[str, int]:
    with closing(sqlite3.connect(path)) as journal:
        return {table: journal.execute(f"SELECT count(*) FROM {table}").fetchone()[0] for table in TABLES}


def with_new_names(text: str, error: str) -> str:
    """The file with each key written as the error says."""
    lines = text.splitlines()
    for number, old_key, new in RENAMED.findall(error):
        before, after = old_key.rpartition(".")[2], new.rpartition(".")[2]
        line = lines[int(number) - 1]
        line = re.sub(rf"^(\[?)(?:{re.escape(before)})\b", rf"\g<1>{after}", line)
        lines[int(number) - 1] = line.replace('"ring"', "false") if after == "free_edge" else line
    return "\n".join(lines) + "\n"


def new_cell(old: Path) -> Path:
    """The old cell's file after the steps of the page."""
    path = old / "cell.toml"
    with pytest.raises(ConfigError) as refused:
        load_config(path)
    text = with_new_names(path.read_text(), str(refused.value))
    example = (ROOT / "examples" / "cell.toml").read_text()
    section = re.compile(r"^\[spindle\]\n(?:(?!\[).*\n)+", re.MULTILINE)
    found = section.search(example)
    assert found is not None
    text = section.sub(lambda _: found.group(), text)
    text = text.replace('"spindle", ', '"devices", ').replace("plan_guard", "plan_checks")
    path.write_text(text)
    (old / "drive.eds").write_bytes((ROOT / "examples" / "drive.eds").read_bytes())
    return path


def test_a_cell_file_is_refused_with_all_new_names_at_once_and_loads_with_them(old: Path) -> None:
    path = old / "cell.toml"
    with pytest.raises(ConfigError) as refused:
        load_config(path)
    keys = {key for _, key, _ in RENAMED.findall(str(refused.value))}
    assert {"part.rim", "dwell.within_s", "dwell.choose", "between", "memory", "job.lookahead_s"} <= keys
    assert load_config(new_cell(old)).cell.name == "bench-cell"


def test_each_name_of_the_page_is_refused_with_its_new_name(old: Path) -> None:
    """The list of the page is that of the code, but for keys of the simulator, profiles and studies."""
    from polishd.config.renamed_keys import renamed_key

    listed = re.findall(r"^- `([\w.]+)`: `([\w.]+)`", PAGE, re.MULTILINE)
    assert len(listed) > 20
    for before, after in listed:
        found = before
        for _ in range(2):
            root, dot, rest = found.partition(".")
            found = f"{renamed_key(root) or root}{dot}{rest}"
            if new := renamed_key(found):
                new = new.partition(" ")[0]
                found = new if "." in new or "." not in found else f"{found.rpartition('.')[0]}.{new}"
        assert found == after, before


def test_its_journal_is_read_without_a_change(old: Path) -> None:
    path = old / "state" / JOURNAL_NAME
    before = hashlib.sha256(path.read_bytes()).hexdigest()
    (job,) = read_history(old / "state")
    assert (job.job, job.part_id, job.outcome) == ("demo", "DEMO-100", "in_tolerance")
    assert [each.rms_nm for each in job.measured] == pytest.approx([6.18, 0.71, 0.94], abs=0.01)
    names = {event["name"] for event in read_events(old / "state", 1000)}
    assert {"pass_started", "map_measured", "estimates_updated"} <= names
    assert not {"pass_begun", "measured", "learned"} & names
    with read_only(old / "state") as journal:
        found = list(journalled_estimates(lambda sql, values=(): journal.execute(sql, values).fetchall()))
        terms = json.loads(journal.execute("SELECT terms FROM job").fetchone()[0])
    assert len(found) == 2
    assert terms["dwell.objective"] == "least"
    assert terms["plugins.load"] == [
        "rnc_robot", "voice_coil", "devices", "interferometer", "removal_models", "dwell_solvers", "plan_checks",
        "run_report",
    ]  # fmt: skip
    assert hashlib.sha256(path.read_bytes()).hexdigest() == before


def test_its_journal_is_converted_without_a_loss_and_kept(old: Path) -> None:
    path = old / "state" / JOURNAL_NAME
    before = counts(path)
    Journal.open(old / "state", job="next", part_id="P-1").close()
    with closing(sqlite3.connect(path)) as journal:
        assert journal.execute("PRAGMA user_version").fetchone() == (SCHEMA_VERSION,)
        arrays = [row[0] for row in journal.execute("SELECT arrays FROM map")]
    assert counts(path) == {**before, "job": before["job"] + 1}
    assert counts(old_copy(path, 5)) == before
    assert arrays
    assert all((old / "state" / ARRAYS_NAME / f"{name}.npz").exists() for name in arrays)
    assert read_history(old / "state")[0].outcome == "in_tolerance"


JOB_TEXT = """# a lens of the second batch
[job]
id = "lens-2"
tolerance_nm = 1.5
lookahead_s = 12.0

[part]
id = "L-2"
rim = "free"
nominal = "form.csv"

[dwell]
choose = "knee"

[limits]
pit_nm = 40.0

[between.clean]
person = true
within_s = 600.0

[memory]
remember = false
"""
"""A job file of version 0.1 with keys that were renamed since, also a table and a key that names a file."""


def queue_old_jobs(old: Path, **texts: str) -> None:
    """Add waiting jobs to the old journal, as version 0.1 stored them; the first is under way."""
    form = {"part.nominal": {"file": "form.csv", "sha256": hashlib.sha256(b"0,0\n1,0\n").hexdigest()}}
    (old / "form.csv").write_text("0,0\n1,0\n")
    with closing(sqlite3.connect(old / "state" / JOURNAL_NAME)) as journal, journal:
        for place, (name, text) in enumerate(texts.items()):
            files = json.dumps(form if "nominal" in text else {})
            row = (place, name, "L-2", str(old / f"{name}.toml"), text, files, 1.0, None if place else 1.0)
            journal.execute(
                "INSERT INTO queue (place, name, part_id, path, content, files, added, begun) VALUES (?,?,?,?,?,?,?,?)",
                row,
            )


def test_jobs_in_its_queue_get_the_new_names_and_keep_their_values_and_order(old: Path) -> None:
    new_cell(old)
    plain = '[job]\nid = "plain"  # no renamed key\n[part]\nid = "L-2"\n'
    queue_old_jobs(old, running=JOB_TEXT, waiting=JOB_TEXT, plain=plain, torn="[job\n")
    with Queue.at_rest(old / "state") as queue:
        running, waiting, other, torn = queue.to_do()
    assert [entry.state for entry in (running, waiting, other, torn)] == ["under way", "waiting", "waiting", "waiting"]
    assert (other.content, torn.content) == (plain, "[job\n")
    for entry in (running, waiting):
        assert tomllib.loads(entry.content) == {
            "job": {"id": "lens-2", "tolerance_nm": 1.5, "stream_ahead_s": 12.0},
            "part": {"id": "L-2", "free_edge": True, "form": "form.csv"},
            "dwell": {"objective": "knee"},
            "limits": {"max_stall_removal_nm": 40.0},
            "part_handling": {"clean": {"operator": True, "timeout_s": 600.0}},
            "estimates": {"use_previous": False},
        }
        assert set(entry.files) == {"part.form"}
    with closing(sqlite3.connect(old_copy(old / "state" / JOURNAL_NAME, 5))) as kept:
        assert kept.execute("SELECT content FROM queue WHERE name = 'waiting'").fetchone() == (JOB_TEXT,)


def test_a_job_of_its_queue_is_laid_over_the_new_cell(old: Path) -> None:
    cell = load_config(new_cell(old))
    text = JOB_TEXT.replace('nominal = "form.csv"\n', "").replace(
        "[between.clean]\nperson = true\nwithin_s = 600.0\n", ""
    )
    queue_old_jobs(old, running='[job]\nid = "x"\n[part]\nid = "X"\n', waiting=text)
    with Queue.at_rest(old / "state") as queue:
        (entry,) = queue.waiting()
    config = require_unchanged(cell, plugins_of(cell), entry)
    assert (config.job.stream_ahead_s, config.part.free_edge, config.limits.max_stall_removal_nm) == (12.0, True, 40.0)


def test_a_job_with_an_old_key_that_is_added_again_is_refused_with_the_new_name(old: Path, polishd: Polishd) -> None:
    path = old / "lens.toml"
    path.write_text(JOB_TEXT)
    said = polishd("queue", "add", new_cell(old), path)
    assert said.code == 3
    assert f"{path}:5: job.lookahead_s: was renamed: write job.stream_ahead_s" in said.err
    assert f"{path}:16: limits.pit_nm: was renamed: write limits.max_stall_removal_nm" in said.err
    assert f"{path}:18: between: was renamed: write part_handling" in said.err


def test_the_other_files_of_its_state_folder_are_read(old: Path) -> None:
    ending = last_ending(old / "state")
    assert (ending["state"], ending["tool_off"], ending["robot_at_rest"]) == ("in_tolerance", "yes", "yes")
    taken = TakenMaps(old / "state" / "maps_taken.json", old / "no folder")
    taken.load()
    with closing(sqlite3.connect(old / "state" / JOURNAL_NAME)) as journal:
        maps = [row[0] for row in journal.execute("SELECT sha256 FROM map")]
    assert len(maps) == 3
    assert taken.any


@pytest.mark.full
def test_its_run_folder_is_certified_and_its_certificate_verified(old: Path, polishd: Polishd) -> None:
    rows = read_rows(old / "run")
    assert json.loads((old / "certificate.json").read_text())["journal"]["sha256"] == rows.sha256
    said = polishd("certificate", "verify", old / "certificate.json")
    assert "is unchanged: its checksum is right" in said.out
    said = polishd("certificate", "make", old / "run", "--out", old / "anew.pdf")
    assert said.code == 0, said.err
    assert "In tolerance: 1 of 1 lines hold" in said.out
    assert not said.err


def test_a_cell_with_that_state_folder_has_its_history_and_estimates(old: Path, polishd: Polishd) -> None:
    cell = new_cell(old)
    said = polishd("history", cell, "--json")
    assert [job["outcome"] for job in said.answer["jobs"]] == ["in_tolerance"]
    assert "in_tolerance" in polishd("status", cell).out
    assert "1.068" in polishd("estimates", "show", cell).out


def test_a_commissioned_profile_stays_commissioned(old: Path) -> None:
    profile = load_profile(old / "instrument.toml")
    assert profile.unproved == ""
    assert profile.instrument.commissioned is not None
