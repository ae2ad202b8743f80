"""Maps from files, for the verbs of ``polishd map``: read, as the instrument's profile says where one is named."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import typer

from polishd.hookspecs import SurfaceReader
from polishd.model.errors import BadMap, ConfigError
from polishd.model.instrument import Instrument
from polishd.model.surface import SurfaceMap

READERS = "interferometer"
"""The plugin of polishd that reads maps. Without the other ones these verbs start in half the time."""


def readers_for(cell: Path | None = None) -> Mapping[str, SurfaceReader]:
    """The readers of the cell's plugins by name, in the order in which they are asked; without a cell polishd's own.

    ConfigError or PluginError where the cell's configuration, or a plugin that it names, is broken.
    """
    if cell is not None:
        from polishd.hooks.cell import load_cell

        return load_cell(cell)[1].surface_readers()
    from polishd.hooks.loader import load_plugins

    return load_plugins([READERS]).surface_readers()


def profile_of(path: Path | None) -> Instrument | None:
    """The instrument's profile; ConfigError where the file is none."""
    if path is None:
        return None
    from polishd.config.profile import load_profile

    return load_profile(path).instrument


def map_from(path: Path, readers: Mapping[str, SurfaceReader], instrument: Instrument | None = None) -> SurfaceMap:
    """A map, as it is or as the profile says; BadMap where it cannot be had."""
    from polishd.recipe.files import read_map

    if path.exists() and not path.is_file():
        raise BadMap(f"{path}: is {'a folder' if path.is_dir() else 'no file'}; name a map file")
    surface = read_map(path, readers.values())
    if instrument is None:
        return surface
    from polishd.process.instrument import as_profiled

    return as_profiled(surface, instrument)


def edges_mm(text: str) -> tuple[float, ...]:
    """Periods of ``--bands``; BadParameter where they are no falling numbers above 0."""
    try:
        edges = tuple(float(word) for word in text.split(","))
    except ValueError:
        edges = ()
    falling = all(a > b for a, b in pairwise(edges))
    if not edges or not falling or not all(0 < edge < math.inf for edge in edges):
        raise typer.BadParameter(f"--bands {text!r}: periods in mm that fall, as 33,0.12")
    return edges


def require_picture(out: Path | None) -> None:
    """ConfigError where ``--out`` is not called ``.png``: it could be somebody's map."""
    if out is not None and out.suffix.lower() != ".png":
        raise ConfigError(f"{out}: a picture is a PNG file; name it *.png")


def shown(path: object) -> str:
    """A path for people: what is no UTF-8 in it is escaped."""
    return str(path).encode("utf-8", "backslashreplace").decode()


def told_apart(paths: Sequence[object]) -> list[str]:
    """Short names for people: of each path the fewest last parts that tell all of them apart."""
    parts = [Path(str(path)).parts for path in paths]
    names = list(map(str, paths))
    for depth in range(1, max(map(len, parts), default=0)):
        tails = [str(Path(*own[-depth:])) for own in parts]
        if len(set(tails)) == len(set(names)):
            return list(map(shown, tails))
    return list(map(shown, names))


def band_names(count: int) -> Sequence[str]:
    """LSF, MSF and HSF for three bands; what lies between low and high is numbered where there are more."""
    middle = ["MSF"] if count == 3 else [f"MSF{number}" for number in range(1, count - 1)]
    return ["LSF", *middle, "HSF"]
