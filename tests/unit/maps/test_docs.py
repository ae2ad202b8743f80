"""docs/how-to/maps.md: each command in it that needs no cell runs as printed, and says what is printed below it."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from polishd.rendering.terminal import WIDE, stdout
from tests.unit.cli_result import Polishd

ROOT = Path(__file__).parents[3]
DRAWING = (ROOT / "docs/reference/tolerance.md").read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]
PAGE = (ROOT / "docs/how-to/maps.md").read_text(encoding="utf-8")


def examples(words: str) -> list[tuple[str, list[str]]]:
    """The commands of the page that hold these words, each with the lines that it is to say."""
    found: list[tuple[str, list[str]]] = []
    for line in PAGE.splitlines():
        if line.startswith("    $ "):
            found.append((line[6:], []))
        elif line.startswith("    ") and found:
            found[-1][1].append(line)
        elif line and found:
            found.append(("", []))
    return [(command, said) for command, said in found if words in command]


def plain(text: str) -> list[str]:
    """Lines without the spaces that layout adds, and without the length that zlib gives a packed file."""
    lines = (" ".join(line.split()) for line in text.splitlines() if line.strip())
    return [re.sub(r"\d+ bytes", "N bytes", line) for line in lines]


def require_said(polishd: Polishd, command: str, promised: list[str]) -> None:
    said = polishd(*shlex.split(command)[1:])
    assert said.code == (8 if promised[0].strip().startswith("polishd: ") else 0), said.err
    assert plain("\n".join(promised)) == [line for line in plain(said.out + said.err) if not line.startswith("drawn")]


@pytest.fixture(autouse=True)
def shell(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(stdout, "_width", WIDE)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    "words",
    [
        "map zygo_metropro.dat --trim",
        "map convert zygo",
        pytest.param("map report", marks=pytest.mark.full),
    ],
)
def test_what_the_page_shows_of_the_shared_maps(
    polishd: Polishd, shared_data: Path, tmp_path: Path, words: str
) -> None:
    for name in ("zygo_metropro.dat", "zygo_mx.datx", "codev.int"):
        (tmp_path / name).symlink_to(shared_data / name)
    (tmp_path / "drawing.toml").write_text(DRAWING)
    ((command, promised),) = examples(words)
    assert len(promised) >= 1
    require_said(polishd, command, promised)


@pytest.mark.full
def test_commissioning_as_the_page_shows_it(polishd: Polishd, tmp_path: Path) -> None:
    """The simulated instrument's artefact proves the shipped profile, and not one that is turned."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples", ignore=shutil.ignore_patterns("plugin"))
    ((copy, _),) = examples("cp examples")
    shutil.copy(*shlex.split(copy)[1:])
    ((simulate, _),) = examples("sim.toml --artefact")
    subprocess.run([sys.executable, *shlex.split(simulate)[1:]], check=True, timeout=60)
    right, wrong = examples("map commission")
    require_said(polishd, *right)
    assert Path("proof.png").stat().st_size > 20_000
    profile = Path("instrument.toml")
    profile.write_text(profile.read_text().replace("rotation_deg = 0", "rotation_deg = 90"))
    require_said(polishd, *wrong)
