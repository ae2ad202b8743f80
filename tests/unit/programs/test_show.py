"""``polishd program`` as from the shell: JSON and tables, exit codes, one message an error, nothing half-written."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from polishd.plugins.rnc_robot.dialect import DIALECTS, dialect
from polishd.plugins.rnc_robot.formats import read
from polishd.programs import show as program_picture
from polishd.rendering.terminal import stdout
from tests.unit.cli_result import Polishd
from tests.unit.plugins.rnc_robot.languages.robot_programs import PROGRAMS

DWELL = b"(a)\nG21 G90 G94 G61.1\nG0 X0 Y0 Z5\nG1 X1 Z0 F60\nG4 P1\nG1 X3\nG4 P.5\nG1 X4 Y-1\nG4 P2\nG0 Z5\nM2".replace(
    b"\n", b"\r\n"
)
"""G61.1 is of rs274 alone: Haas would read P1 as 1 ms."""
FEED = b"G21 G90 G94\nG0 X0 Y0 Z0\nG1 X1 F60\nG1 X3 F240\nM2\n"
KEYS = ["dialect", "lines", "points", "dwell_total_s", "feed_range_mm_min", "bounds_mm", "warnings"]


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal in which no table is cut."""
    monkeypatch.setattr(stdout, "_width", 200)


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "p.rnc"
    path.write_bytes(DWELL)
    return path


def table(path: Path, *rows: object) -> Path:
    path.write_text("".join(f"{row}\n" for row in rows))
    return path


def test_inspect_answers_with_the_promised_keys(polishd: Polishd, program: Path) -> None:
    answer = polishd("program", "inspect", program, "--json").answer
    assert list(answer)[: len(KEYS)] == KEYS
    assert (answer["dialect"], answer["lines"], answer["points"], answer["dwell_total_s"]) == ("rs274", 11, 3, 3.5)
    assert answer["feed_range_mm_min"] == [60.0, 60.0]
    assert answer["bounds_mm"] == {"x": [1.0, 4.0], "y": [-1.0, 0.0], "z": [0.0, 0.0]}
    assert answer["warnings"] == []
    assert (answer["encoding"], answer["unit"]) == ("dwell", "s")
    assert answer["sha256"] == hashlib.sha256(DWELL).hexdigest()


def test_inspect_of_feeds(polishd: Polishd, program: Path) -> None:
    program.write_bytes(FEED.replace(b"G94", b""))
    answer = polishd("program", "inspect", program, "--json").answer
    assert (answer["encoding"], answer["unit"], answer["feed_range_mm_min"]) == ("feed", "mm/min", [60.0, 240.0])
    assert answer["bounds_mm"]["x"] == [1.0, 3.0]
    assert answer["warnings"] == ["no G94 in the program: assumed"]


@pytest.mark.parametrize(
    ("name", "text", "unit"),
    [
        ("rs274", FEED, "mm/min"),
        ("rs274", FEED.replace(b"G21", b"G20"), "inch/min"),
        ("rs274", FEED.replace(b"G1 X3 F240", b"G20\nG1 X3 F9.5"), "mm/min and inch/min"),
        ("fanuc", re.sub(rb"([XYZF]\d+)", rb"\1.", FEED.replace(b"G21", b"G20")), "inch/min"),
        ("siemens", FEED.replace(b"G21", b"G700").replace(b"0\n", b"0.\n"), "inch/min"),
        ("twincat-nci", FEED.replace(b"G21 G90 G94", b"G700 G90"), "inch/min"),
    ],
)
def test_inspect_names_the_unit_of_feeds_as_they_are_written(
    polishd: Polishd, program: Path, name: str, text: bytes, unit: str
) -> None:
    program.write_bytes(text)
    assert polishd("program", "inspect", program, "--dialect", name, "--json").answer["unit"] == unit
    assert read(dialect(name), text, "p.rnc").unit == unit


def test_inspect_for_people(polishd: Polishd, program: Path) -> None:
    program.write_bytes(FEED.replace(b"G94", b""))
    said = polishd("program", "inspect", program)
    assert said.code == 0
    for words in ("p.rnc", "2, time in the feed of each move (mm/min)", "60 to 240 mm/min", "1.0000 to 3.0000 mm"):
        assert words in said.out
    assert "warning: no G94 in the program: assumed" in said.out


@pytest.mark.full
@pytest.mark.parametrize("verb", ["inspect", "rewrite", "verify"])
def test_a_refusal_names_the_dialect_that_was_only_assumed(polishd: Polishd, tmp_path: Path, verb: str) -> None:
    program = tmp_path / "made.nc"
    program.write_bytes(b"G710 G90 G94\nG0 X0 Y0\nG1 X1 F60\nG4 F1\nM30\n")  # of a Sinumerik, without its mark
    (tmp_path / "d.csv").write_text("1\n")
    rest = {"inspect": [], "rewrite": ["--dwell", tmp_path / "d.csv", "--out", tmp_path / "n.nc"], "verify": [program]}
    said = polishd("program", verb, program, *rest[verb])
    assert said.code == 9
    assert "was read as rs274" in said.err
    assert "give --dialect" in said.err
    said = polishd("program", verb, program, *rest[verb], "--dialect", "rs274")
    assert said.code == 9
    assert "was read as" not in said.err


def test_inspect_draws(polishd: Polishd, tmp_path: Path) -> None:
    path = tmp_path / "$a_{1}$.rnc"
    path.write_bytes(DWELL)
    said = polishd("program", "inspect", path, "--picture", tmp_path / "p.png")
    assert (said.code, f"written to {tmp_path / 'p.png'}" in said.out) == (0, True)
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    none = tmp_path / "none" / "p.png"
    said = polishd("program", "inspect", path, "--picture", none)
    assert said.code == 3
    assert f"{none}: cannot be written: No such file or directory. Name another file with --picture." in said.err


def test_a_robot_language_answers_with_the_same_keys(polishd: Polishd, program: Path, tmp_path: Path) -> None:
    ours = polishd("program", "inspect", program, "--json").answer
    path = tmp_path / "p.script"
    path.write_bytes(PROGRAMS["urscript"].text)
    answer = polishd("program", "inspect", path, "--dialect", "urscript", "--json").answer
    assert list(answer) == list(ours)
    assert (answer["dialect"], answer["points"], answer["dwell_total_s"]) == ("urscript", 2, 1.5)
    assert answer["bounds_mm"] == {"x": [100.0, 101.0], "y": [200.0, 200.0], "z": [300.0, 300.0]}
    said = polishd("program", "inspect", path, "--dialect", "urscript")
    assert (said.code, "2, time in dwell blocks (s)" in said.out) == (0, True)


def test_an_unknown_feed_is_no_number(polishd: Polishd, program: Path) -> None:
    program.write_bytes(b"G21 G90 G93\nG0 X0 Y0 Z0 A0 C0\nG1 A5 F30\nG1 X1 F60\nM2\n")
    answer = polishd("program", "inspect", program, "--json").answer
    assert answer["feed_range_mm_min"] == [0.0, 60.0]
    assert (answer["encoding"], answer["unit"], answer["dwell_total_s"]) == ("inverse", "1/min", 3.0)


@pytest.mark.full
def test_of_very_many_points_some_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read_back = read(dialect("rs274"), DWELL, "p.rnc")
    whole = program_picture.program_picture(read_back)
    monkeypatch.setattr(program_picture, "MOST_DOTS", 2)
    thinned = program_picture.program_picture(read_back)
    assert whole != thinned
    assert thinned.startswith(b"\x89PNG")


def test_rewrite_changes_the_times_and_nothing_else(polishd: Polishd, program: Path, tmp_path: Path) -> None:
    out = tmp_path / "new.rnc"
    rows = table(tmp_path / "d.csv", 0.25, 0.125, 3)
    answer = polishd("program", "rewrite", program, "--dwell", rows, "--out", out, "--json").answer
    expected = DWELL.replace(b"P1", b"P0.25").replace(b"P.5", b"P.125").replace(b"P2", b"P3")
    assert out.read_bytes() == expected
    assert answer["out"] == [str(out)]
    assert (answer["points"], answer["encoding"]) == (3, "dwell")
    assert answer["dwell_total_s"] == answer["asked_total_s"] == 3.375
    assert stat.S_IMODE(out.stat().st_mode) == 0o644


def test_a_table_of_zeros_is_written_with_a_warning(polishd: Polishd, program: Path, tmp_path: Path) -> None:
    said = polishd(
        "program", "rewrite", program, "--dwell", table(tmp_path / "d.csv", 0, 0, 0), "--out", tmp_path / "n"
    )
    assert "all 3 rows are 0 s: the new program removes nothing" in said.out
    again = polishd("program", "rewrite", program, "--dwell", tmp_path / "d.csv", "--out", tmp_path / "m", "--json")
    assert len(again.answer["warnings"]) == 1


def test_an_empty_name_of_a_file_is_refused(polishd: Polishd, program: Path, tmp_path: Path) -> None:
    dwell = table(tmp_path / "d.csv", 1, 2, 3)
    said = polishd("program", "rewrite", program, "--dwell", dwell, "--out", "")
    assert said.code == 2
    assert "'--out': the name is empty" in said.err


def test_rewriting_with_its_own_times_is_the_same_bytes(polishd: Polishd, program: Path, tmp_path: Path) -> None:
    out = tmp_path / "new.rnc"
    said = polishd("program", "rewrite", program, "--dwell", table(tmp_path / "d.csv", 1, 0.5, 2), "--out", out)
    assert said.code == 0
    assert "new.rnc" in said.out
    assert out.read_bytes() == DWELL


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ((1, 2), "d.csv, row 3 is missing: the program has more points"),
        ((1, 2, 3, 4), "d.csv, row 4 is one too many: the program has 3 points"),
        ((1, 2, 3, 4, 5), "d.csv, row 4 is one too many: the program has 3 points"),
        (("dwell_s", 1, 2, 3), 'row 1 is a header: "dwell_s"'),
        ((1, "x", 3), 'row 2 is not a number: "x"'),
        ((1, -2, 3), 'row 2 is below zero: "-2"'),
        ((1, 2, "nan"), 'row 3 is not finite: "nan"'),
        ((), "the table of dwells is empty"),
        ((1, 2, 1e12), "row 3 asks for more than 1000000 s (12 days) at one point"),
    ],
)
def test_a_table_that_does_not_fit_writes_nothing(
    polishd: Polishd, program: Path, tmp_path: Path, rows: tuple[object, ...], says: str
) -> None:
    out = tmp_path / "new.rnc"
    said = polishd("program", "rewrite", program, "--dwell", table(tmp_path / "d.csv", *rows), "--out", out, "--json")
    assert said.failure == 9
    assert says in said.err
    assert said.err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.csv", "p.rnc"]


@pytest.mark.full
@pytest.mark.parametrize("way", ["itself", "a link", "the table"])
def test_what_is_read_is_not_overwritten(polishd: Polishd, program: Path, tmp_path: Path, way: str) -> None:
    rows = table(tmp_path / "d.csv", 1, 2, 3)
    out = {"itself": tmp_path / "x" / ".." / "p.rnc", "a link": tmp_path / "link.rnc", "the table": rows}[way]
    (tmp_path / "x").mkdir()
    (tmp_path / "link.rnc").symlink_to(program)
    said = polishd("program", "rewrite", program, "--dwell", rows, "--out", out)
    assert said.code == 9
    assert "name another file" in said.err
    assert program.read_bytes() == DWELL
    assert rows.read_text() == "1\n2\n3\n"


def test_an_output_that_cannot_be_written_is_one_message(polishd: Polishd, program: Path, tmp_path: Path) -> None:
    rows = table(tmp_path / "d.csv", 1, 2, 3)
    for out in (tmp_path, tmp_path / "none" / "new.rnc"):
        said = polishd("program", "rewrite", program, "--dwell", rows, "--out", out)
        assert said.code == 9
        assert "cannot be written" in said.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.csv", "p.rnc"]


def test_an_old_output_survives_a_full_disk(
    polishd: Polishd, program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "new.rnc"
    out.write_bytes(b"old")

    def full(_handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    rows = table(tmp_path / "d.csv", 1, 2, 3)
    said = polishd("program", "rewrite", program, "--dwell", rows, "--out", out, "--force")
    assert (said.code, "No space left on device" in said.err) == (9, True)
    assert out.read_bytes() == b"old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.csv", "new.rnc", "p.rnc"]


@pytest.mark.parametrize("encoding", [(), ("--encoding", "inverse")], ids=["streamed", "held"])
def test_an_existing_file_is_replaced_only_with_force(
    polishd: Polishd, program: Path, tmp_path: Path, encoding: tuple[str, ...]
) -> None:
    out = tmp_path / "new.rnc"
    out.write_bytes(b"old")
    words = ("rewrite", program, "--dwell", table(tmp_path / "d.csv", 1, 2, 3), "--out", out, *encoding)
    said = polishd("program", *words, "--json")
    assert (said.failure, out.read_bytes()) == (3, b"old")
    assert f"{out}: exists already; name another file, or say --force" in said.err
    assert polishd("program", *words, "--force").code == 0
    assert out.read_bytes() != b"old"


def test_verify_proves(polishd: Polishd, program: Path, tmp_path: Path) -> None:
    new = tmp_path / "new.rnc"
    new.write_bytes(DWELL.replace(b"P2", b"P2.5"))
    answer = polishd("program", "verify", program, new, "--json").answer
    assert answer["identical_motion"] is True
    assert (answer["changed_points"], answer["largest_change_s"]) == (1, 0.5)
    assert (answer["time_before_s"], answer["time_after_s"]) == (3.5, 4.0)
    assert answer["other_changes"] == []
    said = polishd("program", "verify", program, new)
    assert (said.code, "identical" in said.out, "NOT" in said.out) == (0, True, False)


@pytest.mark.skipif(shutil.which("rs274") is None, reason="LinuxCNC is not installed")
def test_verify_with_linuxcnc(polishd: Polishd, program: Path) -> None:
    said = polishd("program", "verify", program, program, "--with", "rs274")
    assert said.code == 0
    assert "LinuxCNC: " in said.out
    program.write_bytes(DWELL.replace(b"F60", b"F60 P9"))


def test_verify_without_linuxcnc_says_how_to_get_it(
    polishd: Polishd, program: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("polishd.plugins.rnc_robot.verify.exact_python", lambda: None)
    said = polishd("program", "verify", program, program, "--with", "rs274", "--json")
    assert said.failure == 9
    assert "apt-get install" in said.err


def test_verify_says_where_motion_differs_and_exits_9(polishd: Polishd, program: Path, tmp_path: Path) -> None:
    new = tmp_path / "new.rnc"
    new.write_bytes(DWELL.replace(b"X3", b"X3.01").replace(b"M2", b"M30"))
    said = polishd("program", "verify", program, new)
    assert said.code == 9
    assert "NOT proved identical" in said.out
    assert "3, times not compared" in said.out
    assert 'also changed: line 11 "M2" became line 11 "M30"' in said.out
    assert 'new.rnc: not proved to move as p.rnc does: line 6 "G1 X3\\r" became line 6 "G1 X3.01\\r"' in said.err
    said = polishd("program", "verify", program, new, "--json")
    assert said.code == 9
    assert '"identical_motion": false' in said.out
    found = json.loads(said.out)
    assert (found["changed_points"], found["largest_change_s"]) == (None, None)
    assert said.err.count("\n") == 1


def test_many_changes_are_cut_for_people_only(polishd: Polishd, tmp_path: Path) -> None:
    moves = b"".join(b"G1 X%d F60\nG4 P1\n" % i for i in range(1, 100))
    old, new = tmp_path / "a.rnc", tmp_path / "b.rnc"
    old.write_bytes(b"G21 G90 G94 G61.1\nG0 X0 Y0 Z0\n" + moves + b"M2\n")
    new.write_bytes(old.read_bytes().replace(b"\n", b" (c)\n"))
    said = polishd("program", "verify", old, new)
    assert said.out.count("also changed: line") == program_picture.SHOWN
    assert f"also changed: {201 - program_picture.SHOWN} more; --json has them" in said.out
    assert len(polishd("program", "verify", old, new, "--json").answer["other_changes"]) == 201


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "p.rnc: the file is empty"),
        (b"\x7fELF\x02\x01\x01\x00\x00", "p.rnc, line 1: byte 0x7f"),
        (b"\xff\xfeG\x001\x00", "byte order mark"),
        (b"G1 X#1 F60\nM2\n", "p.rnc, line 1: "),
        (DWELL.replace(b"M2", b""), "without M2"),
        (b"G21\nM2\n", "nothing in it carries time"),
    ],
    ids=["empty", "binary", "UTF-16", "variables", "cut short", "no points"],
)
def test_a_program_that_cannot_be_read_is_one_message(
    polishd: Polishd, program: Path, tmp_path: Path, content: bytes, says: str
) -> None:
    program.write_bytes(content)
    good = tmp_path / "good.rnc"
    good.write_bytes(DWELL)
    rows = table(tmp_path / "d.csv", 1, 2, 3)
    for words in (
        ("inspect", program),
        ("rewrite", program, "--dwell", rows, "--out", tmp_path / "new.rnc"),
        ("verify", good, program),
        ("verify", program, good),
    ):
        said = polishd("program", *words)
        assert (said.code, said.out, said.err.count("\n")) == (9, "", 1), said
        assert says in said.err
        assert "To do: " in said.err
    assert not (tmp_path / "new.rnc").exists()


@pytest.mark.full
def test_files_that_are_none(polishd: Polishd, program: Path, tmp_path: Path) -> None:
    for path, says in ((tmp_path, "Is a directory"), (tmp_path / "none.rnc", "No such file")):
        for words in (("inspect", path), ("verify", program, path), ("verify", path, program)):
            said = polishd("program", *words)
            assert (said.code, said.out) == (9, "")
            assert says in said.err
        said = polishd("program", "rewrite", program, "--dwell", path, "--out", tmp_path / "new.rnc")
        assert (said.code, says in said.err) == (9, True)


def test_the_dialect_is_asked_for_and_never_guessed(polishd: Polishd, tmp_path: Path) -> None:
    path = tmp_path / "p.haas"
    path.write_bytes(b"G21 G90 G94\nG0 X0. Y0. Z0.\nG1 X1. F60.\nG4 P500\nM30\n")
    rows, out = table(tmp_path / "d.csv", 0.5), tmp_path / "n.nc"
    for words in (("inspect", path), ("rewrite", path, "--dwell", rows, "--out", out), ("verify", path, path)):
        said = polishd("program", *words, "--json")
        assert said.failure == 9
        assert "p.haas:4: several dialects fit" in said.err
        assert "as 500 s (rs274, grbl) and 0.5 s (fanuc, haas, siemens-iso, weihong)" in said.err
        assert "Say --dialect" in said.err
    assert not out.exists()
    assert polishd("program", "inspect", path, "--dialect", "rs274", "--json").answer["dwell_total_s"] == 500.0
    assert polishd("program", "inspect", path, "--dialect", "haas", "--json").answer["dwell_total_s"] == 0.5
    own = tmp_path / "own.toml"
    own.write_text('extends = "haas"\nname = "ours"\n')
    answer = polishd("program", "inspect", path, "--dialect", own, "--json").answer
    assert (answer["dialect"], answer["dwell_total_s"]) == ("ours", 0.5)
    said = polishd("program", "inspect", path, "--dialect", "hass")
    assert (said.code, "did you mean 'haas'?" in said.err) == (3, True)


def test_a_pipe_needs_its_dialect(polishd: Polishd, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "p.nc")
    said = polishd("program", "inspect", tmp_path / "p.nc")
    assert (said.code, "give --dialect" in said.err) == (9, True)


def test_the_dialect_of_the_docs_is_read_as_they_say(polishd: Polishd, tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "programs.md").read_text()
    own = tmp_path / "shop.toml"
    own.write_text(page.split("A dialect is a TOML file")[1].split("```toml\n")[1].split("```")[0])
    path = tmp_path / "p.nc"
    path.write_bytes(b"G21 G90 G94\nG0 X0. Y0. Z0. B0. C0.\n/G0 X9.\nG1 X1. F60.\nG4 X500\nM30\n")
    answer = polishd("program", "inspect", path, "--dialect", own, "--json").answer
    assert (answer["dialect"], answer["dwell_total_s"], answer["unit"]) == ("shop", 0.5, "ms")


def test_dialects_are_listed(polishd: Polishd) -> None:
    answer = polishd("program", "dialects", "--json").answer["dialects"]
    assert tuple(entry["name"] for entry in answer) == DIALECTS
    by_name = {entry["name"]: entry for entry in answer}
    assert by_name["haas"]["dwell"] == ["P ms without a point, s with a point"]
    assert by_name["grbl"]["resolution_s"] == 0.05
    assert by_name["twincat-cnc"]["inverse"] == "s"
    assert by_name["fanuc-tp"]["most_lines"] == 32000
    said = polishd("program", "dialects").out
    for name in DIALECTS:
        assert name in said
        assert dialect(name).name == name


@pytest.mark.full
def test_a_pipe_that_breaks_is_no_traceback(program: Path, tmp_path: Path) -> None:
    program.write_bytes(b"G21 G90 G94\nG0 X0 Y0 Z0\n" + b"".join(b"G1 X%d F9\n" % i for i in range(1, 50)) + b"M2\n")
    for words in (["inspect", str(program)], ["verify", str(program), str(program), "--json"]):
        reading, writing = os.pipe()
        os.close(reading)
        ended = subprocess.run(
            [sys.executable, "-m", "polishd.cli.app", "program", *words],
            stdout=writing, stderr=subprocess.PIPE, check=False, timeout=60,
        )  # fmt: skip
        os.close(writing)
        assert b"Traceback" not in ended.stderr
        assert ended.returncode != 0


@pytest.mark.full
def test_a_large_program_comes_back_as_asked(polishd: Polishd, tmp_path: Path) -> None:
    """Large enough for the compiled reader and writer."""
    n = 6000
    path, out = tmp_path / "p.rnc", tmp_path / "new.rnc"
    body = "".join(f"G1 X{i % 100}.{i % 7} Y{i // 100} F600\nG4 P0.{1 + i % 8}\n" for i in range(n))
    path.write_text(f"G21 G90 G94\nG0 X0 Y0 Z0\n{body}M2\n")
    times = np.random.default_rng(5).uniform(0.01, 3.0, n).round(4)
    rows = table(tmp_path / "d.csv", *times)
    answer = polishd("program", "rewrite", path, "--dwell", rows, "--out", out, "--json").answer
    assert answer["dwell_total_s"] == pytest.approx(times.sum(), abs=1e-4)
    assert np.abs(read(dialect("rs274"), out.read_bytes(), "new").time_s - times).max() <= 1e-4
    assert polishd("program", "verify", path, out, "--json").answer["identical_motion"] is True


def test_a_picture_does_not_take_the_programs_place(polishd: Polishd, program: Path) -> None:
    said = polishd("program", "inspect", program, "--picture", program)
    assert (said.code, program.read_bytes()) == (9, DWELL)
    assert "is what is read" in said.err


@pytest.mark.parametrize("verb", ["inspect", "rewrite", "verify"])
def test_what_cannot_be_looked_at_is_a_program_error(polishd: Polishd, tmp_path: Path, verb: str) -> None:
    long = tmp_path / ("x" * 300)
    words: dict[str, list[object]] = {
        "inspect": [long],
        "rewrite": [long, "--dwell", table(tmp_path / "d.csv", 1), "--out", long],
        "verify": [long, long],
    }
    said = polishd("program", verb, *words[verb])
    assert said.code == 9
    assert "cannot be read: File name too long" in said.err


def test_what_may_not_be_read_is_a_program_error(
    polishd: Polishd, program: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda *_, **__: False)  # what typer asks, and is yes to root
    for words in (("inspect", program), ("verify", program, program)):
        assert polishd("program", *words).code == 0
    assert polishd("program", "rewrite", program, "--dwell", program, "--out", program.with_name("n")).code == 9


def test_rewrite_says_which_moves_keep_their_time(polishd: Polishd, program: Path, tmp_path: Path) -> None:
    program.write_bytes(DWELL.replace(b"M2", b"G1 X5 F60\r\nM2"))
    rows = table(tmp_path / "d.csv", 1, 2, 3)
    said = polishd("program", "rewrite", program, "--dwell", rows, "--out", tmp_path / "n.rnc", "--encoding", "inverse")
    assert "1 moves that had no dwell and keep their time" in said.out
    plain = polishd("program", "rewrite", program, "--dwell", rows, "--out", tmp_path / "m.rnc")
    assert "keep their time" not in plain.out
