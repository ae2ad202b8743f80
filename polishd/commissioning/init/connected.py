"""Devices connected to this computer, as defaults of answers. No port is opened, and no file is written."""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import typer
from serial.tools import list_ports

from polishd.hookspecs import SurfaceReader
from polishd.maps.map_files import MapSource, readers_for
from polishd.model.errors import MapError, PolishdError
from polishd.model.surface import IN_UNITS, SurfaceMap
from polishd.pipeline.run_folder import read_map
from polishd.plugins.interferometer.formats.common import nm_per
from polishd.process.metrology.conditioning import resample_square, scale_fault
from polishd.util.serialization import toml

INTERFACES = Path("/sys/class/net")
BY_ID = Path("/dev/serial/by-id")
ARPHRD_CAN = "280"
"""What Linux has in an interface's ``type`` where that is CAN (linux/if_arp.h)."""
MOST_TRIED = 5
"""Files of a folder that are read, the newest first, until one is a map."""


@dataclass(frozen=True, slots=True)
class SerialPort:
    """A serial port that is there."""

    path: str
    """By its device's own name where the system has one: that stays when it is plugged in elsewhere."""
    what: str


@dataclass(frozen=True, slots=True)
class MapFolder:
    """A folder with maps in it."""

    folder: Path
    sample: Path
    """The newest file that a reader knows."""
    format: str


@dataclass(frozen=True, slots=True)
class Connected:
    """What was found."""

    serial: tuple[SerialPort, ...] = ()
    can: tuple[str, ...] = ()
    """Names of CAN interfaces; polishd reaches them through socketcand."""
    maps: tuple[MapFolder, ...] = ()

    def lines(self) -> list[str]:
        """For people."""
        found = [f"serial port {port.path}: {port.what}" for port in self.serial]
        found += [f"CAN interface {name}: through socketcand://127.0.0.1:29536/{name}" for name in self.can]
        found += [f"maps in {one.folder}: {one.sample.name} is {one.format}" for one in self.maps]
        return found or ["no serial port, no CAN interface, no folder with maps beside here"]


def look(here: Path) -> Connected:
    """What is connected, and which folders, here or just below, have maps in them."""
    below = sorted(path for path in here.iterdir() if path.is_dir() and not path.name.startswith("."))
    folders = [path for path in (here, *below) if os.access(path, os.R_OK | os.X_OK)]
    return Connected(_serial_ports(), can_interfaces(INTERFACES), tuple(map_folders(folders)))


def _serial_ports() -> tuple[SerialPort, ...]:
    named = {path.resolve(): path for path in BY_ID.glob("*")}
    return tuple(
        SerialPort(str(named.get(Path(port.device).resolve(), port.device)), port.description)
        for port in sorted(list_ports.comports())
        if port.hwid != "n/a"  # a port on the board's list that nothing is known of
    )


def can_interfaces(of: Path) -> tuple[str, ...]:
    """Names of the CAN interfaces below this folder of the kernel's."""
    return tuple(path.parent.name for path in sorted(of.glob("*/type")) if path.read_text().strip() == ARPHRD_CAN)


def map_folders(folders: Iterable[Path]) -> list[MapFolder]:
    """Those of the folders in which one of the newest files is a map."""
    readers = readers_for().values()
    endings = {suffix for reader in readers for suffix in reader.suffixes}
    found = []
    for folder in folders:
        files = [path for path in folder.iterdir() if path.is_file() and path.suffix.lower() in endings]
        newest = sorted(files, key=lambda path: path.stat().st_mtime, reverse=True)[:MOST_TRIED]
        found += [one for one in [_first_map(folder, newest, readers)] if one is not None]
    return found


def _first_map(folder: Path, files: Iterable[Path], readers: Collection[SurfaceReader]) -> MapFolder | None:
    for path in files:
        try:
            surface = read_map(path, readers)
        except PolishdError:
            continue  # another kind of file
        return MapFolder(folder, path, surface.format)
    return None


# The start of an instrument's profile and of the part, from one map.

TEMPLATE = """\
# The profile of an instrument: docs/how-to/instruments.md. All keys: docs/reference/profile.md
# A changed value makes the record of `polishd map commission` void.
name = {name}
{says}
[orientation]                        # arrays are mirrored left-right if mirror, then rotated counter-clockwise:
mirror = false                       # the part as the tool sees it, x right, y up
rotation_deg = 0                     # 0, 90, 180, 270

[height]
sign = 1                             # -1 if high is negative
factor = 1.0                         # 0.5 if its files give wavefronts in reflection
{unit}
[registration]
by = "none"                          # the center of the array is the part's; or aperture, fiducials, both

# [artefact]                         # TODO: what proves all this: bumps in no symmetric arrangement, as the tool
# name = "three bumps"               # sees them; here those of an example
# bumps = [
#   {{ x_mm = 20.0, y_mm = 12.0, sigma_x_mm = 9.0, sigma_y_mm = 5.0, height_nm = 120.0 }},
#   {{ x_mm = -14.0, y_mm = 24.0, sigma_x_mm = 4.0, sigma_y_mm = 4.0, height_nm = 80.0 }},
#   {{ x_mm = -8.0, y_mm = -22.0, sigma_x_mm = 5.0, sigma_y_mm = 5.0, height_nm = -60.0 }},
# ]
"""
UNIT = "# unit_nm = 1.0                      # TODO: its files name no unit; nanometers per unit\n"


@dataclass(frozen=True, slots=True)
class SampleMap:
    """A map of the instrument."""

    name: str
    surface: SurfaceMap
    aperture_mm: float
    """Diameter of the round part that it shows."""
    pitch_mm: float | None = None
    """As it was answered: its files do not say it."""
    unit_nm: float | None = None
    """Of its heights, likewise."""
    coordinate_unit_mm: float | None = None
    """Of its coordinates, likewise."""

    @property
    def part_id(self) -> str:
        """The part's name in it; empty where it has none."""
        return self.surface.part_id


def missing_of(surface: SurfaceMap) -> str:
    """The answer that gives a sample its lateral scale; empty where it has one."""
    if surface.pitch_mm is not None or surface.pitches_mm is not None:
        return ""
    return "sample_units" if IN_UNITS in surface.factors else "sample_pitch_mm"


def read_sample(path: Path, units: str | None = None, pitch_mm: float | None = None) -> SampleMap:
    """The map, with what was answered of it: ``units`` as of ``--units``, and its pitch where the file has none.

    Raises:
        MapError: no reader knows it, or it has no lateral scale to tell a size by; it says which answer gives one.
    """
    try:
        read = MapSource.of(units=units).read(path)
    except typer.BadParameter as error:
        raise MapError(f"{path}: {error.message.replace('--units', 'sample_units')}") from error
    if pitch_mm is not None and missing_of(read) == "sample_pitch_mm":
        if fault := scale_fault(read.height_nm.shape, pitch_mm):
            raise MapError(f"{path}: sample_pitch_mm = {pitch_mm:g}: {fault}. Correct it")
        settled = read.doubts.get("pitch")
        read = replace(
            read,
            pitch_mm=pitch_mm,
            unsaid=read.unsaid - {"pitch"},
            doubts={key: words for key, words in read.doubts.items() if key != "pitch"},
            warnings=tuple(words for words in read.warnings if words != settled),
        )
    elif pitch_mm is None:
        pitch_mm = read.pitch_mm if units is not None and not read.pitches_mm else None
    surface = resample_square(read)
    if surface.pitch_mm is None:
        key = missing_of(surface)
        example = '"mm,nm"' if key == "sample_units" else "0.1"
        raise MapError(f"{path}: its file has no lateral scale. Give instrument.{key}, as {key} = {example}.")
    lateral, height = read.factors.get("units", (None, None))
    unit_nm = None if height is None else nm_per(height)
    coordinate_nm = None if lateral is None or IN_UNITS not in read.factors else nm_per(lateral)
    return SampleMap(
        path.name,
        surface,
        aperture_mm(surface, surface.pitch_mm),
        pitch_mm,
        unit_nm,
        None if coordinate_nm is None else coordinate_nm / 1e6,
    )


def aperture_mm(surface: SurfaceMap, pitch_mm: float) -> float:
    """Diameter, mm, of the round part that a map shows, centred in its frame."""
    rows, columns = np.nonzero(surface.valid)
    if not rows.size:
        raise MapError(f"{surface.path}: has no data; name another map")
    extent = (min(np.ptp(rows), np.ptp(columns)) + 1) * pitch_mm
    return math.floor(float(extent))


def profile_text(sample: SampleMap | None) -> str:
    """Return the instrument's profile from one map; values that you must give are comments."""
    if sample is None:
        return TEMPLATE.format(name=toml("interferometer"), says="", unit="")
    surface = sample.surface
    says = [f"# Begun from {sample.name}, {surface.format}.", *(f"# It says: {text}" for text in surface.warnings)]
    if surface.instrument:
        says.append(f"# serials = [{toml(surface.instrument)}]  # a word of that: maps of any other are refused")
    if open_ := sorted(surface.unsaid & {"surface", "orientation"}):
        says.append(f"# gives = {toml(open_)}  # TODO: its files do not say that; make it true below, take # off")
    name = toml(surface.instrument or "interferometer")
    unit = UNIT if "unit" in surface.unsaid else ""
    if sample.unit_nm is not None:
        unit = f"unit_nm = {sample.unit_nm:g}                      # nanometres per unit, as was answered\n"
    if sample.pitch_mm is not None or sample.coordinate_unit_mm is not None:
        unit += "\n[lateral]\n"
    if sample.pitch_mm is not None:
        unit += f"pitch_mm = {sample.pitch_mm:.9g}  # of a pixel on the part, as was answered\n"
    if sample.coordinate_unit_mm is not None:
        unit += f"coordinate_unit_mm = {sample.coordinate_unit_mm:g}  # per unit of coordinates, as was answered\n"
    return TEMPLATE.format(name=name, says="\n".join(says) + "\n", unit=unit)
