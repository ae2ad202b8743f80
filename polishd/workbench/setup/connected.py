"""What is connected to this computer, as defaults of answers. Lists only: no port is opened, no folder written to."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports

from polishd.hookspecs import SurfaceReader
from polishd.model.errors import PolishdError
from polishd.recipe.files import read_map
from polishd.workbench.maps.files import readers_for

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
