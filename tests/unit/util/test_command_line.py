"""A record whose fields are a command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner, Result

from polishd.util.command_line import Json, spread_options


@dataclass(frozen=True, slots=True)
class Asked:
    """What is asked for."""

    shape: Annotated[str, typer.Argument(metavar="SHAPE")]
    pitch_mm: Annotated[float, typer.Option("--pitch", metavar="MM", help="Distance of the lines.")] = 1.0
    out: Path | None = None


def called(*words: str) -> tuple[Result, list[tuple[Path, Asked, bool]]]:
    seen: list[tuple[Path, Asked, bool]] = []
    app = typer.Typer()

    @app.command()
    @spread_options
    def make(file: Path, asked: Asked, as_json: Json = False) -> None:
        """Make it."""
        seen.append((file, asked, as_json))

    return CliRunner().invoke(app, list(words)), seen


def test_the_record_is_what_was_said() -> None:
    _, seen = called("f.nc", "raster", "--pitch", "0.5", "--out", "x", "--json")
    assert seen == [(Path("f.nc"), Asked("raster", 0.5, Path("x")), True)]


def test_what_is_not_said_is_as_the_record_has_it() -> None:
    _, seen = called("f.nc", "raster")
    assert seen == [(Path("f.nc"), Asked("raster"), False)]


def test_the_help_is_that_of_the_fields() -> None:
    said, _ = called("--help")
    for words in ("Make it.", "SHAPE", "--pitch", "MM", "Distance of the lines.", "1.0", "--out", "--json"):
        assert words in said.output, words


@pytest.mark.parametrize(
    "words", [("f.nc",), ("f.nc", "raster", "--pitch", "wide"), ("f.nc", "raster", "--asked", "x")]
)
def test_what_does_not_fit_is_refused_as_ever(words: tuple[str, ...]) -> None:
    said, seen = called(*words)
    assert said.exit_code == 2
    assert not seen
