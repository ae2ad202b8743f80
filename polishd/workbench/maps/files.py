"""Maps from files, for the verbs of ``polishd map``: read, as the instrument's profile says where one is named."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from polishd.hookspecs import SurfaceReader
from polishd.model.errors import ConfigError, MapError
from polishd.model.instrument import Instrument
from polishd.model.surface import SurfaceMap
from polishd.plugins.interferometer.formats.scales import IN_UNITS, NO_PITCH, nm_per, pitch
from polishd.recipe.files import read_map
from polishd.show.tables import stdout
from polishd.workbench.maps.masks import Mask, masked
from polishd.workbench.maps.options import ReadOptions

if TYPE_CHECKING:  # these verbs start in half the time without
    from polishd.config.cell import CellConfig
    from polishd.process.absolute import SystemMap

PROFILED = "its history says that a profile is in it: not applied again"
"""The warning of a map that was turned and scaled before."""
READERS = "interferometer"
"""The plugin of polishd that reads maps. Without the other ones these verbs start in half the time."""


@dataclass(frozen=True, slots=True)
class MapSource:
    """Who reads maps, and the profile by which they are turned and scaled."""

    readers: Mapping[str, SurfaceReader]
    """By name, in the order in which they are asked."""
    asked: Sequence[SurfaceReader]
    """Those of them that read files."""
    instrument: Instrument | None = None
    masks: tuple[Mask, ...] = ()
    """Laid over each map, as the profile turns it."""
    partly: bool = True
    """The profile need not say all that a file leaves open: enough to look."""
    system: SystemMap | None = None
    """The instrument's own error, taken off each map that still has it."""
    units: tuple[str | None, str] | None = None
    """Of places and heights, of files that do not say theirs."""

    @classmethod
    def of(
        cls,
        cell: Path | None = None,
        profile: Path | None = None,
        as_format: str | None = None,
        masks: Sequence[str] | None = None,
        *,
        units: str | None = None,
        partly: bool = True,
        system: bool = True,
    ) -> MapSource:
        """The cell's plugins and its instrument's profile, without a cell polishd's own plugins.

        ``profile`` is taken instead of the cell's. ``system``: take the profile's system map off, where it names one.

        Raises:
            ConfigError, PluginError: a file is broken.

        ``as_format``: read files as this format or ending, whatever they are called; BadParameter where it is none. Of
        a mask, as ``--mask`` has it, that is none: what ``Mask.of`` raises.
        """
        config, readers = _of_cell(cell)
        asked = tuple(readers.values()) if as_format is None else _of_format(readers, as_format)
        instrument = system_map = None
        path = config.profile_path if profile is None and config is not None else profile
        if path is not None:
            from polishd.config.profile import load_profile
            from polishd.recipe.making import system_of_profile

            given = load_profile(path)
            instrument = given.instrument
            own = {} if cell is None else {"cell": cell.name}
            system_map = system_of_profile(given, readers.values(), **own) if system else None
        source = cls(readers, asked, instrument, partly=partly, system=system_map, units=_units(units))
        return replace(source, masks=tuple(Mask.of(text, source.read) for text in masks or ()))

    @classmethod
    def by(cls, asked: ReadOptions, *, system: bool = True) -> MapSource:
        """As the command line asks; errors: those of ``of``."""
        return cls.of(asked.cell, asked.profile, asked.as_format, asked.masks, units=asked.units, system=system)

    @property
    def options(self) -> dict[str, Any]:
        """How maps are read, for a history: values of JSON."""
        told: dict[str, Any] = {"mask": [mask.text for mask in self.masks]} if self.masks else {}
        told |= {"profile": self.instrument.name} if self.instrument is not None else {}
        told |= {"units": [one for one in self.units if one]} if self.units is not None else {}
        return told | ({"system": self.system.surface.sha256} if self.system is not None else {})

    @property
    def read_by(self) -> str:
        """How maps are read, in a line for people."""
        if self.instrument is None:
            return "maps are taken as their files say: no instrument's profile is named"
        less = "" if self.system is None else ", less its system map"
        return f"maps are read by the profile {self.instrument.name!r}{less}"

    def read(self, path: Path) -> SurfaceMap:
        """A map, as it is or as far as the profile says, within the masks; BadMap where it cannot be had."""
        try:
            odd = path.exists() and not path.is_file()
        except OSError as error:  # a name that is too long, a folder that may not be entered
            raise MapError(f"{path}: cannot be read: {error.strerror}; name a map file") from error
        if odd:
            raise MapError(f"{path}: is {'a folder' if path.is_dir() else 'no file'}; name a map file")
        surface = read_map(path, self.asked)
        if self.units is not None:
            surface = _in_units(surface, *self.units)
        if self.instrument is not None:
            surface = self._as_profiled(surface, self.instrument)
        return masked(surface, self.masks)

    def _as_profiled(self, surface: SurfaceMap, instrument: Instrument) -> SurfaceMap:
        """Once: what a verb made of profiled maps is taken as it is, and so what the system map is off already."""
        step = surface.history
        if self.partly and step is not None and step.profiled:
            surface = replace(surface, warnings=(*surface.warnings, PROFILED))
        else:
            from polishd.process.instrument import as_profiled

            surface = as_profiled(surface, instrument, partly=self.partly)
        if self.system is None or (step is not None and step.less_system):
            return surface
        factors = {**surface.factors, "system": self.system.surface.sha256}
        return replace(self.system.off(surface), factors=factors)


def readers_for(cell: Path | None = None) -> Mapping[str, SurfaceReader]:
    """The readers of the cell's plugins by name, in the order in which they are asked; without a cell polishd's own."""
    return _of_cell(cell)[1]


def _of_cell(cell: Path | None) -> tuple[CellConfig | None, Mapping[str, SurfaceReader]]:
    """The cell, None without one, and the readers."""
    if cell is not None:
        from polishd.hooks.cell import load_cell

        config, hooks = load_cell(cell)
        return config, hooks.surface_readers()
    from polishd.hooks.loader import load_plugins

    return None, load_plugins([READERS]).surface_readers()


def _units(text: str | None) -> tuple[str | None, str] | None:
    """Of ``--units``; BadParameter where they are none of length."""
    if text is None:
        return None
    words = [word.strip() for word in text.split(",")]
    if len(words) > 2 or any(nm_per(word) is None for word in words):
        raise typer.BadParameter(
            f"--units {text!r}: two units of length, of places and heights, as mm,nm; or one, of heights"
        )
    return (words[0] if len(words) == 2 else None), words[-1]


def _in_units(surface: SurfaceMap, lateral: str | None, height: str) -> SurfaceMap:
    """The map with the units that its file does not say."""
    nm, mm = nm_per(height) or 1.0, None if lateral is None else nm_per(lateral)
    pitches = surface.factors.get(IN_UNITS)
    answered = {"unit"} & surface.unsaid
    found = NO_PITCH
    if mm is not None and pitches is not None and surface.pitch_mm is None:
        answered = answered | {"pitch"}
        found = pitch(surface.path or Path(), *(value * mm / 1e6 for value in pitches))
    if not answered:
        return replace(surface, warnings=(*surface.warnings, f"--units {height}: not used: the file says its own"))
    settled = {surface.doubts.get(key) for key in answered}
    left = {key: words for key, words in surface.doubts.items() if key not in answered}
    new = dict(found.doubts) if "pitch" in answered else {}
    return replace(
        surface,
        height_nm=surface.height_nm * nm if "unit" in answered else surface.height_nm,
        pitch_mm=found.mm if "pitch" in answered else surface.pitch_mm,
        pitches_mm=found.both_mm if "pitch" in answered else surface.pitches_mm,
        factors={**surface.factors, "units": [lateral, height]},
        unsaid=(surface.unsaid - answered) | new.keys(),
        doubts=left | new,
        warnings=(*(words for words in surface.warnings if words not in settled), *new.values()),
    )


def _of_format(readers: Mapping[str, SurfaceReader], name: str) -> Sequence[SurfaceReader]:
    """The reader of this name, for any file; or those of this ending, as if files had it."""
    if name in readers:
        return [replace(readers[name], sniff=lambda _head, _path: True)]
    suffix = f".{name.removeprefix('.').lower()}"
    found = [_as_if(reader, suffix) for reader in readers.values() if suffix in reader.suffixes]
    if not found:
        raise typer.BadParameter(f"--format {name!r}: one of {', '.join(readers)}, or one of their endings")
    return found


def _as_if(reader: SurfaceReader, suffix: str) -> SurfaceReader:
    return replace(reader, sniff=lambda head, path: reader.sniff(head, path.with_suffix(suffix)))


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


def draw(out: Path, picture: bytes, *, as_json: bool) -> None:
    """Write the PNG, and tell people."""
    from polishd.show.style import save_picture

    save_picture(out, picture)
    if not as_json:
        stdout.print(f"drawn in {printable(out)}", markup=False)


def printable(path: object) -> str:
    """A path for people: what is no UTF-8 in it is escaped."""
    return str(path).encode("utf-8", "backslashreplace").decode()


def or_dash(value: float | None, form: str, unit: str = "") -> str:
    """A figure for people; a dash where there is none."""
    return "-" if value is None else f"{value:{form}}{unit}"


def warnings(names: Sequence[str], answers: Sequence[Mapping[str, Any]]) -> list[str]:
    """What is to be known of each map, for people."""
    return [
        f"warning: {name}: {printable(warning)}"
        for name, answer in zip(names, answers, strict=True)
        for warning in answer["warnings"]
    ]


def distinguish_names(paths: Sequence[object]) -> list[str]:
    """Short names for people: of each path the fewest last parts that tell all of them apart."""
    parts = [Path(str(path)).parts for path in paths]
    names = list(map(str, paths))
    for depth in range(1, max(map(len, parts), default=0)):
        tails = [str(Path(*own[-depth:])) for own in parts]
        if len(set(tails)) == len(set(names)):
            return list(map(printable, tails))
    return list(map(printable, names))


def band_names(count: int) -> Sequence[str]:
    """LSF, MSF and HSF for three bands; what lies between low and high is numbered where there are more."""
    middle = ["MSF"] if count == 3 else [f"MSF{number}" for number in range(1, count - 1)]
    return ["LSF", *middle, "HSF"]
