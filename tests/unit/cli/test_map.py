"""``polishd map``: files and verbs in one place, and what can be read."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from polishd.maps.inspect import EXTRAS, format_answer
from polishd.maps.map_files import readers_for
from polishd.rendering.terminal import stdout
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import dat, surface

VERBS = ("figures", "compare", "convert", "commission", "formats")


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stdout, "_width", 160)


def test_without_a_word_it_helps(polishd: Polishd) -> None:
    said = polishd("map")
    assert said.code == 2
    for verb in VERBS:
        assert verb in said.out + said.err
    assert polishd("map", "--help").code == 0


@pytest.mark.full
def test_files_come_without_a_verb(polishd: Polishd, tmp_path: Path) -> None:
    path = dat(tmp_path / "m.dat", surface())
    direct = polishd("map", path, "--json").answer
    assert polishd("map", "figures", path, "--json").answer == direct
    assert polishd("map", "--json", path).answer == direct
    assert polishd("map", "--trim", 0, "--json", "--", path).answer == direct


def test_options_alone_are_no_map(polishd: Polishd) -> None:
    said = polishd("map", "--json")
    assert said.code == 2
    assert "FILE" in said.err


@pytest.mark.one_of_each
@pytest.mark.parametrize("verb", VERBS)
def test_a_file_that_is_called_like_a_verb(
    polishd: Polishd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    monkeypatch.chdir(tmp_path)
    dat(tmp_path / verb, surface())
    assert polishd("map", f"./{verb}", "--json").answer["path"] == verb
    assert polishd("map", "figures", verb, "--json").answer["path"] == verb
    assert polishd("map", "--json", verb).answer["path"] == verb


def test_the_help_of_a_file_is_that_of_the_figures(polishd: Polishd) -> None:
    said = polishd("map", "m.dat", "--help")
    assert said.code == 0
    assert "--trim" in said.out


@pytest.mark.parametrize("words", [("--trim", "-1"), ("--trim", "x"), ("--nonsense",)])
def test_options_that_are_none(polishd: Polishd, tmp_path: Path, words: tuple[str, ...]) -> None:
    assert polishd("map", dat(tmp_path / "m.dat", surface()), *words).code == 2


HEAVY = ("matplotlib", "h5py", "x3pio", "sdfio", "astropy", "numba", "pymodbus", "can", "clarabel")


@pytest.mark.full
@pytest.mark.parametrize(
    ("words", "never"),
    [((), ("numpy", "scipy", "pydantic", *HEAVY)), (("m.dat", "--json"), HEAVY)],
    ids=["the program itself", "a map"],
)
def test_what_is_not_needed_is_not_imported(tmp_path: Path, words: tuple[str, ...], never: tuple[str, ...]) -> None:
    """What keeps the start short; what it takes is measured by benchmarks/bench_import.py."""
    dat(tmp_path / "m.dat", surface())
    code = (
        "import atexit, sys\n"
        f"atexit.register(lambda: print(*(name for name in {never!r} if name in sys.modules), file=sys.stderr))\n"
        f"import polishd.cli.app\nsys.argv = ['polishd', 'map', *{words!r}]\n"
        f"{'polishd.cli.app.main()' if words else ''}"
    )
    ended = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, check=True, timeout=60)
    assert ended.stderr.decode().strip() == ""
    assert bool(ended.stdout) == bool(words)


@pytest.mark.full
def test_blas_is_held_to_one_thread_unless_asked(tmp_path: Path) -> None:
    """Before numpy looks; what the user set stays."""
    code = (
        "import sys, polishd.cli.app, polishd.maps.inspect as verbs, os\n"
        "shown = [os.environ.get, 'OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS']\n"
        "verbs.formats_verb = lambda cell, as_json: print(*map(shown[0], shown[1:]))\n"
        "sys.argv = ['polishd', 'map', 'formats']\npolishd.cli.app.main()"
    )
    clean = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    ended = subprocess.run(
        [sys.executable, "-c", code], env={**clean, "OMP_NUM_THREADS": "2"}, capture_output=True, check=True, timeout=60
    )
    assert ended.stdout.decode().split() == ["2", "1"]


def test_formats_are_those_of_the_plugin(polishd: Polishd) -> None:
    answers = polishd("map", "formats", "--json").answer["formats"]
    assert [answer["name"] for answer in answers] == list(readers_for())
    by_name = {answer["name"]: answer for answer in answers}
    assert by_name["metropro"] == {
        "name": "metropro", "suffixes": [".dat"], "reads": True, "writes": True, "dates": True, "extra": None,
        "installed": True, "own": True,
    }  # fmt: skip
    assert ".fits.gz" in by_name["fits"]["suffixes"]
    assert {name for name, answer in by_name.items() if not answer["dates"]} == {
        "gwy",
        "tiff",
        "npy",
        "codev",
        "points",
        "wyko_ascii",
    }
    said = polishd("map", "formats")
    assert said.code == 0
    for answer in answers:
        assert answer["name"] in said.out


def test_what_needs_an_extra_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    reader = readers_for()["gwy"]
    assert format_answer(reader)["extra"] == "gwy"
    monkeypatch.setattr("polishd.util.extras.find_spec", lambda _: None)
    answer = format_answer(reader)
    assert (answer["installed"], answer["reads"], answer["writes"]) == (False, False, False)


def test_extras_of_readers_are_extras_of_the_installation() -> None:
    named = {answer["extra"] for answer in map(format_answer, readers_for().values())} - {None}
    assert {"fits", "gwy", "tiff"} <= named <= set(EXTRAS)


@pytest.mark.full
def test_a_full_disk_behind_stdout_is_one_line() -> None:
    """For tables as for JSON, and nothing more as Python ends."""
    for words in (("formats",), ("formats", "--json")):
        with Path("/dev/full").open("wb") as full:
            command = [sys.executable, "-m", "polishd.cli.app", "map", *words]
            ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, check=False, timeout=60)
        assert ended.returncode == 1
        assert ended.stderr == b"polishd: standard output: No space left on device; make room\n"
