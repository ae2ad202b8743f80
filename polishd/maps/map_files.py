"""Maps from files for the verbs of ``polishd map``, read by the instrument's profile where one is named."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from polishd import __version__
from polishd.hookspecs import SurfaceReader
from polishd.maps.options import ReadOptions
from polishd.model.errors import ComputeError, ConfigError, MapError
from polishd.model.instrument import Instrument
from polishd.model.outline import Circle, Outline, hexagon, rectangle
from polishd.model.surface import IN_UNITS, BoolArray, FloatArray, MapInput, MapStep, MaskCount, SurfaceMap
from polishd.pipeline.run_folder import read_map
from polishd.plugins.interferometer.formats.common import Pitch, checked, nm_per, oddities
from polishd.process.metrology.conditioning import SAME_PITCH, with_coordinate_unit
from polishd.rendering.terminal import stdout
from polishd.util.files import require_writable_file

if TYPE_CHECKING:
    from polishd.config.cell import CellConfig
    from polishd.process.metrology.absolute_test import SystemMap


# ``--mask`` of the map verbs: samples that count, by shapes, corners in a file, or the data of another map.

FORMS = (
    "circle:X,Y,R, annulus:X,Y,R,r, rectangle:X,Y,W,H, hexagon:X,Y,W, polygon:FILE, map:FILE; before it not: for what "
    "lies outside, px: for pixels"
)
Inside = Callable[[FloatArray, FloatArray], BoolArray]
"""Whether points lie in a shape, by x (1, nx) and y (ny, 1)."""


@dataclass(frozen=True, slots=True)
class Mask:
    """One ``--mask``; lengths are mm from the map's center, or px: columns and rows from its upper left sample."""

    text: str
    """Text of the option."""
    what: Inside | SurfaceMap
    """A shape, or a map whose samples with data count."""
    inverted: bool = False
    in_px: bool = False

    @classmethod
    def of(cls, text: str, read: Callable[[Path], SurfaceMap]) -> Mask:
        """Parse a ``--mask``; ``read`` reads a map that it names, in the same way as the masked maps.

        Raises:
            BadParameter: it is no mask.
            ConfigError: a file of corners that cannot be read, with its line.
            SurfaceError: a map that cannot be.
        """
        marks: set[str] = set()
        kind, _, rest = text.partition(":")
        while kind in ("not", "px") and kind not in marks:
            marks.add(kind)
            kind, _, rest = rest.partition(":")
        in_px, inverted = "px" in marks, "not" in marks
        if kind == "polygon" and rest:
            from polishd.config.table_files import read_polygon  # lazy: most calls do not need it

            outline = read_polygon(Path(rest), ("column", "row") if in_px else ("x_mm", "y_mm"))
            return cls(text, _about((0.0, 0.0), outline), inverted, in_px)
        if kind == "map" and rest:
            if in_px:
                raise typer.BadParameter(f"--mask {text!r}: a map has its own samples; leave out px:")
            return cls(text, read(Path(rest)), inverted)
        return cls(text, _shape(text, kind, rest), inverted, in_px)

    def holds(self, surface: SurfaceMap) -> BoolArray:
        """(ny, nx) samples of a map inside the mask. MapError where that is unknown."""
        if isinstance(self.what, SurfaceMap):
            found = _valid_on(surface, self.what)
        elif self.in_px:
            ny, nx = surface.height_nm.shape
            found = self.what(np.arange(float(nx))[None, :], np.arange(float(ny))[:, None])
        elif surface.pitch_mm is None:
            raise MapError(f"{surface.path}: has no lateral scale for --mask {self.text}; give the instrument's "
                         f"--profile, or the mask in pixels: px:{self.text.removeprefix('not:')}")  # fmt: skip
        else:
            found = self.what(*surface.grid.axes_mm)
        return np.asarray(found != self.inverted)


def masked(surface: SurfaceMap, masks: Sequence[Mask]) -> SurfaceMap:
    """The map without samples outside any mask, and the sample count of each; MapError where none is left."""
    if not masks:
        return surface
    valid = surface.valid
    left, counts = valid.copy(), []
    for mask in masks:
        held = mask.holds(surface) & valid
        counts.append(MaskCount(mask.text, int(np.count_nonzero(held)), int(np.count_nonzero(valid))))
        if not held.any():
            raise MapError(f"{surface.path}: --mask {mask.text} holds none of its {counts[-1].of} samples with data; "
                         f"{_size(surface)}")  # fmt: skip
        left &= held
    if not left.any():
        raise MapError(f"{surface.path}: no sample with data lies in all of the {len(masks)} masks; use fewer")
    return replace(surface, height_nm=np.where(left, surface.height_nm, np.nan), masks=(*surface.masks, *counts))


def mask_records(surface: SurfaceMap) -> list[dict[str, Any]]:
    """Each mask with its number of samples, for ``--json``."""
    return [count._asdict() for count in surface.masks]


def mask_map(surface: SurfaceMap) -> int:
    """Samples with data that lie outside one of the masks."""
    return surface.masks[0].of - int(np.count_nonzero(surface.valid)) if surface.masks else 0


def mask_words(record: Mapping[str, Any]) -> str:
    """Sample count of a mask, for people."""
    return f"holds {record['samples']} of {record['of']} samples with data"


def mask_lines(names: Sequence[str], answers: Sequence[Mapping[str, Any]]) -> list[str]:
    """Lines on the masks of several maps, for people."""
    return [
        f"{name}: mask {record['mask']} {mask_words(record)}"
        for name, answer in zip(names, answers, strict=True)
        for record in answer["masks"]
    ]


def _shape(text: str, kind: str, rest: str) -> Inside:
    """Samples inside ``circle:X,Y,R`` and the other shapes."""
    try:
        values = [float(word) for word in rest.split(",")]
    except ValueError:
        values = []
    try:
        match kind, values:
            case "circle", [x, y, radius]:
                return _about((x, y), Circle(radius))
            case "annulus", [x, y, outer, inner]:
                if inner >= outer:
                    raise typer.BadParameter(f"--mask {text!r}: its hole is not smaller than itself; X,Y,R,r has R > r")
                ring, hole = _about((x, y), Circle(outer)), _about((x, y), Circle(inner))
                return lambda x_mm, y_mm: ring(x_mm, y_mm) & ~hole(x_mm, y_mm)
            case "rectangle", [x, y, width, height]:
                return _about((x, y), rectangle(width, height))
            case "hexagon", [x, y, flats]:
                return _about((x, y), hexagon(flats))
    except ComputeError as error:
        raise typer.BadParameter(f"--mask {text!r}: {error}") from error
    raise typer.BadParameter(f"--mask {text!r} is not a shape. Use {FORMS}")


def _about(centre: tuple[float, float], outline: Outline) -> Inside:
    if not np.isfinite(centre).all():
        raise ComputeError("its centre is no finite number")
    return lambda x, y: outline.contains(x - centre[0], y - centre[1])


def _valid_on(surface: SurfaceMap, other: SurfaceMap) -> BoolArray:
    """(ny, nx) samples of a map where the nearest sample of the other has data, center on center."""
    pitch, its = surface.pitch_mm, other.pitch_mm
    same_shape = other.height_nm.shape == surface.height_nm.shape
    if same_shape and (pitch is None or its is None or abs(its - pitch) <= SAME_PITCH * pitch):
        return other.valid
    if pitch is None or its is None:
        raise MapError(f"{other.path}: as a mask it has not the samples of {surface.path}, and one of both has no "
                     "lateral scale; give the instrument's --profile")  # fmt: skip
    ny, nx = other.height_nm.shape
    row = np.rint((other.grid.y_mm[0] - surface.grid.y_mm) / its).astype(np.int64)
    column = np.rint((surface.grid.x_mm - other.grid.x_mm[0]) / its).astype(np.int64)
    there = ((row >= 0) & (row < ny))[:, None] & ((column >= 0) & (column < nx))[None, :]
    return np.asarray(there & other.valid[np.ix_(row.clip(0, ny - 1), column.clip(0, nx - 1))])


def _size(surface: SurfaceMap) -> str:
    ny, nx = surface.height_nm.shape
    if surface.pitch_mm is None:
        return f"the map is {nx} x {ny} px"
    wide, high = nx * surface.pitch_mm, ny * surface.pitch_mm
    return f"the map is {wide:g} x {high:g} mm about its centre, or {nx} x {ny} px"


PROFILED = "its history says that a profile is in it: not applied again"
"""Warning about a map that a profile has turned and scaled before."""
READERS = "interferometer"
"""polishd's plugin with the map readers. Without the other plugins the verbs start in half the time."""


@dataclass(frozen=True, slots=True)
class MapSource:
    """Readers of maps, and the profile that turns and scales them."""

    readers: Mapping[str, SurfaceReader]
    """By name, in the order in which they are tried."""
    asked: Sequence[SurfaceReader]
    """The readers that are used for files."""
    instrument: Instrument | None = None
    masks: tuple[Mask, ...] = ()
    """Applied to each map after the profile."""
    partly: bool = True
    """The profile need not state everything that a file omits: enough for viewing."""
    system: SystemMap | None = None
    """The instrument's own error, subtracted from each map that still has it."""
    units: tuple[str | None, str] | None = None
    """Units of positions and heights, for files that do not state theirs."""

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
        path = profile
        if profile is None and config is not None and config.profile_path is not None:
            path = config.file("instrument.profile", config.profile_path)
        if path is not None:
            from polishd.config.instrument_profile import load_profile
            from polishd.pipeline.build_recipe import system_of_profile

            given = load_profile(path)
            instrument = given.instrument
            own = {} if cell is None else {"cell": cell.name}
            system_map = system_of_profile(given, readers.values(), **own) if system else None
        source = cls(readers, asked, instrument, partly=partly, system=system_map, units=_units(units))
        return replace(source, masks=tuple(Mask.of(text, source.read) for text in masks or ()))

    @classmethod
    def by(cls, asked: ReadOptions, *, system: bool = True) -> MapSource:
        """The source for the options of the command line; errors as of ``of``."""
        return cls.of(asked.cell, asked.profile, asked.as_format, asked.masks, units=asked.units, system=system)

    @property
    def options(self) -> dict[str, Any]:
        """Options for reading maps, as JSON values for a history."""
        found: dict[str, Any] = {"mask": [mask.text for mask in self.masks]} if self.masks else {}
        found |= {"profile": self.instrument.name} if self.instrument is not None else {}
        found |= {"units": [one for one in self.units if one]} if self.units is not None else {}
        return found | ({"system": self.system.surface.sha256} if self.system is not None else {})

    @property
    def read_by(self) -> str:
        """Line about how maps are read, for people."""
        if self.instrument is None:
            return "maps are taken as their files say: no instrument's profile is named"
        less = "" if self.system is None else ", less its system map"
        return f"maps are read by the profile {self.instrument.name!r}{less}"

    def read(self, path: Path) -> SurfaceMap:
        """Read a map with profile and masks; MapError where it cannot be read."""
        try:
            odd = path.exists() and not path.is_file()
        except OSError as error:  # the name is too long, or the folder cannot be entered
            raise MapError(f"{path}: cannot be read: {error.strerror}; name a map file") from error
        if odd:
            raise MapError(f"{path}: is {'a folder' if path.is_dir() else 'no file'}; name a map file")
        surface = read_map(path, self.asked)
        if self.units is not None:
            surface = _in_units(surface, *self.units)
        surface = _with_scale_advice(surface)
        if self.instrument is not None:
            surface = self._as_profiled(surface, self.instrument)
        return masked(surface, self.masks)

    def _as_profiled(self, surface: SurfaceMap, instrument: Instrument) -> SurfaceMap:
        """Apply profile and system map, unless a verb applied them before."""
        step = surface.history
        if self.partly and step is not None and step.profiled:
            surface = replace(surface, warnings=(*surface.warnings, PROFILED))
        else:
            from polishd.process.metrology.instrument import apply_profile

            surface = apply_profile(surface, instrument, partly=self.partly)
        if self.system is None or (step is not None and step.less_system):
            return surface
        factors = {**surface.factors, "system": self.system.surface.sha256}
        return replace(self.system.off(surface), factors=factors)


def readers_for(cell: Path | None = None) -> Mapping[str, SurfaceReader]:
    """Readers of the cell's plugins by name, in the order in which they are tried; polishd's own without a cell."""
    return _of_cell(cell)[1]


def _of_cell(cell: Path | None) -> tuple[CellConfig | None, Mapping[str, SurfaceReader]]:
    """The cell (None without one), and the readers."""
    if cell is not None:
        from polishd.plugin_loader import load_cell

        config, hooks = load_cell(cell)
        return config, hooks.surface_readers()
    from polishd.plugin_loader import load_plugins

    return None, load_plugins([READERS]).surface_readers()


def _units(text: str | None) -> tuple[str | None, str] | None:
    """Units of ``--units``; BadParameter where they are no units of length."""
    if text is None:
        return None
    words = [word.strip() for word in text.split(",")]
    if len(words) > 2 or any(nm_per(word) is None for word in words):
        raise typer.BadParameter(
            f"--units {text!r}: use two units of length, of coordinates and heights, such as mm,nm, or one"
        )
    return (words[0] if len(words) == 2 else None), words[-1]


def _with_scale_advice(surface: SurfaceMap) -> SurfaceMap:
    """The map with the option that gives its lateral scale in the warning that it has none."""
    warning = surface.doubts.get("pitch")
    if warning is None or surface.pitch_mm is not None:
        return surface
    units = IN_UNITS in surface.factors
    advice = "give --units, such as --units mm,nm" if units else "give --profile with lateral.pitch_mm"
    advised = f"{warning}: {advice}"
    warnings = tuple(advised if one == warning else one for one in surface.warnings)
    return replace(surface, warnings=warnings, doubts={**surface.doubts, "pitch": advised})


def _in_units(surface: SurfaceMap, lateral: str | None, height: str) -> SurfaceMap:
    """The map with the units that its file does not state; MapError for a size or heights that no map has."""
    nm, mm = nm_per(height) or 1.0, None if lateral is None else nm_per(lateral)
    scaled = surface if mm is None else with_coordinate_unit(surface, mm / 1e6)
    if scaled is surface and "unit" not in surface.unsaid:
        return replace(surface, warnings=(*surface.warnings, f"--units {height}: not used: the file says its own"))
    scaled = replace(scaled, factors={**surface.factors, "units": [lateral, height]})
    if "unit" in surface.unsaid:
        settled = surface.doubts.get("unit")
        scaled = replace(
            scaled,
            height_nm=checked(surface.path or Path(), surface.height_nm * nm, nm),
            unsaid=scaled.unsaid - {"unit"},
            doubts={key: words for key, words in scaled.doubts.items() if key != "unit"},
            warnings=tuple(words for words in scaled.warnings if words != settled),
        )
    odd = oddities(scaled.height_nm, Pitch(scaled.pitch_mm, both_mm=scaled.pitches_mm))
    new = [words for words in odd if words not in scaled.warnings]
    return replace(scaled, warnings=(*scaled.warnings, *new))


def _of_format(readers: Mapping[str, SurfaceReader], name: str) -> Sequence[SurfaceReader]:
    """The reader of this name, for any file; or the readers of this ending, for files with any ending."""
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
    """Periods of ``--bands``; BadParameter unless they are falling numbers above 0."""
    try:
        edges = tuple(float(word) for word in text.split(","))
    except ValueError:
        edges = ()
    falling = all(a > b for a, b in pairwise(edges))
    if not edges or not falling or not all(0 < edge < math.inf for edge in edges):
        raise typer.BadParameter(f"--bands {text!r}: use periods in mm in descending order, such as 33,0.12")
    return edges


def require_picture(out: Path | None) -> None:
    """ConfigError where the picture cannot be written, or does not end in ``.png``: it could be a map."""
    if out is None:
        return
    if out.suffix.lower() != ".png":
        raise ConfigError(f"{out}: a picture is a PNG file; name it *.png")
    require_writable_file(out)


def draw(out: Path, picture: bytes, option: str = "--out", *, as_json: bool) -> None:
    """Write the PNG, and print its name for people."""
    from polishd.rendering.plots import save_picture

    save_picture(out, picture, option)
    if not as_json:
        stdout.print(f"drawn in {printable(out)}", markup=False)


def printable(path: object) -> str:
    """A path for people, with invalid UTF-8 escaped."""
    return str(path).encode("utf-8", "backslashreplace").decode()


def or_dash(value: float | None, form: str, unit: str = "") -> str:
    """A figure for people; a dash where there is none."""
    return "-" if value is None else f"{value:{form}}{unit}"


def warnings(names: Sequence[str], answers: Sequence[Mapping[str, Any]]) -> list[str]:
    """Warnings about each map, for people."""
    return [
        f"warning: {name}: {printable(warning)}"
        for name, answer in zip(names, answers, strict=True)
        for warning in answer["warnings"]
    ]


def distinguish_names(paths: Sequence[object]) -> list[str]:
    """Short names for people: the fewest last parts of each path that distinguish all of them."""
    parts = [Path(str(path)).parts for path in paths]
    names = list(map(str, paths))
    for depth in range(1, max(map(len, parts), default=0)):
        tails = [str(Path(*own[-depth:])) for own in parts]
        if len(set(tails)) == len(set(names)):
            return list(map(printable, tails))
    return list(map(printable, names))


def band_names(count: int) -> Sequence[str]:
    """LSF, MSF and HSF for three bands; the middle ones are numbered where there are more."""
    middle = ["MSF"] if count == 3 else [f"MSF{number}" for number in range(1, count - 1)]
    return ["LSF", *middle, "HSF"]


# The history in results of ``polishd map``.

SHORT = 12
"""Digits of a hash for people."""


def history_step(
    surface: SurfaceMap,
    verb: str,
    inputs: Sequence[tuple[str, SurfaceMap]],
    source: MapSource,
    known_nm: float | None = None,
    **options: Any,
) -> SurfaceMap:
    """The map with its last step added.

    Args:
        surface: the result.
        verb: of ``polishd map``.
        inputs: what each map that was read was to the verb, and the map: "map", "system error", ...
        source: how they were read: masks and profile are options, too.
        known_nm: how sure a sample of the result is, one standard deviation; None: not known.
        options: what else was asked for, values of JSON; those that are None or False were not.
    """
    everything = source.options | options
    asked = {key: value for key, value in everything.items() if value is not None and value is not False}
    parts = tuple(
        MapInput(role, one.path.name if one.path is not None else "", one.sha256, one.history) for role, one in inputs
    )
    return replace(surface, history=MapStep(verb, __version__, asked, parts, known_nm))


def uncertainty_nm(surface: SurfaceMap) -> float | None:
    """Uncertainty of a sample by the map's history, one standard deviation; None where it is not stated."""
    return None if surface.history is None else surface.history.uncertainty_nm


def known_lines(known_nm: float | None) -> list[str]:
    """Line on the uncertainty of a result of several maps, for people."""
    if known_nm is None:
        return ["the uncertainty of a sample is unknown: not every map states its own, as means of repeats do"]
    return [f"a sample is known to {known_nm:.4f} nm (one standard deviation), if the maps' errors are independent"]


def history_record(surface: SurfaceMap) -> dict[str, Any] | None:
    """The last step with the histories of its inputs, for ``--json``."""
    return None if surface.history is None else asdict(surface.history)


def history_rows(step: Mapping[str, Any] | None) -> Iterator[tuple[str, str]]:
    """Rows for people: one for each step, the last first, and one for each of its inputs."""
    if step is None:
        return
    options = ", ".join(f"{key} {_words(value)}" for key, value in step["options"].items())
    known = "" if step["uncertainty_nm"] is None else f"; a sample known to {step['uncertainty_nm']:.4g} nm"
    yield f"made by {step['verb']}", printable(f"polishd {step['version']}{f'; {options}' if options else ''}{known}")
    for one in step["inputs"]:
        yield f"  {one['role']}", printable(f"{one['name']}, sha256 {one['sha256'][:SHORT]}")
        for word, text in history_rows(one["history"]):
            yield f"    {word}", text


def _words(value: Any) -> str:
    if isinstance(value, Mapping):  # for programs only: a matrix of the instrument's terms
        return f"({', '.join(value)})"
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
