"""``polishd doctor``: check what a computer offers to a cell. No device is opened, and nothing moves."""

from __future__ import annotations

import ctypes
import getpass
import grp
import importlib.metadata
import os
import platform
import re
import socket
import stat
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal

import typer
from packaging.requirements import Requirement
from packaging.version import Version
from serial.tools import list_ports

from polishd.commissioning.compile_ahead import is_compiled_ahead
from polishd.commissioning.init.connected import INTERFACES, can_interfaces
from polishd.config.cell import CellConfig, load_config
from polishd.daemon.runtime.process import LOOP_NICE, PriorityResult, loop_first
from polishd.drivers.transport.address import SerialLine, SlcanAddress, SocketcandAddress, Tcp, parse_address
from polishd.model.errors import ConfigError, DeviceError, PolishdError
from polishd.pipeline.disk_space import FreeSpace, SpaceNeeded, free_space
from polishd.plugin_loader import plugins_of
from polishd.rendering.terminal import emit, record_table
from polishd.util.jit import has_compiler

State = Literal["ok", "warning", "problem"]
STATES: tuple[State, ...] = ("ok", "warning", "problem")
VersionOf = Callable[[str], str | None]
"""Return the version of an installed distribution, None without it."""
COLUMNS = ("check", "state", "found", "what to do")
COARSEST_S = 1e-3
"""Largest resolution of the monotonic clock that the time limits of contact allow."""
UNSYNCHRONIZED = 5
"""TIME_ERROR: result of adjtimex for a clock without synchronization."""
SERIAL_GROUP = "dialout"


@dataclass(frozen=True, slots=True)
class DoctorRow:
    """One line of the table. A problem prevents work; a warning prevents some of it, or makes it less reliable."""

    check: str
    state: State
    found: str
    todo: str = ""
    exit_code: int = ConfigError.exit_code
    """Exit code of the command if this is a problem."""


def doctor_verb(cell: Path | None, *, as_json: bool) -> None:
    """Print the table; exit with the code of the worst problem."""
    rows = examine(cell)
    counts = Counter(row.state for row in rows)
    worst = max((row.exit_code for row in rows if row.state == "problem"), default=0)
    checks = [{"check": one.check, "state": one.state, "found": one.found, "todo": one.todo} for one in rows]
    following = (
        "polishd doctor CELL.toml for a cell, polishd demo without one" if cell is None else f"polishd check {cell}"
    )
    if worst:
        following = "do what the last column says, then run polishd doctor again"
    emit(
        {"checks": checks, "counts": {state: counts[state] for state in STATES}, "exit_code": worst},
        as_json=as_json,
        table=lambda: record_table("doctor: no device was opened", COLUMNS, map(_cells, rows)),
        lines=[f"{', '.join(f'{counts[state]} {state}' for state in STATES)}. Next: {following}"],
    )
    if worst:
        raise typer.Exit(worst)


def _cells(row: DoctorRow) -> tuple[str, str, str, str]:
    return row.check, row.state, row.found, row.todo


def examine(cell: Path | None) -> list[DoctorRow]:
    """Return all rows; those of the cell's devices if one is given."""
    config, refused = None, []
    if cell is not None:
        try:
            config = load_config(cell)
        except PolishdError as error:
            refused = [DoctorRow("cell", "problem", *_split(str(error)))]
    folder = Path() if config is None else config.state_dir
    needed = {"opcua"} if config is not None and config.opcua is not None else set()
    own = importlib.metadata.distribution("polishd")
    with loop_first() as granted:
        pass
    return [
        *software_rows(own.metadata["Requires-Python"] or "", own.metadata.get_all("Classifier") or ()),
        *dependency_rows(own.requires or (), installed_version),
        *extra_rows(own.requires or (), installed_version, needed),
        *compiled_rows(),
        serial_row([port.device for port in list_ports.comports() if port.hwid != "n/a"], os.getgroups()),
        can_row(INTERFACES),
        *priority_rows(granted),
        *systemd_rows(Path("/"), os.getuid(), getpass.getuser()),
        *clock_rows(),
        *disk_rows(folder, (config and config.run_dir) or folder),
        *refused,
        *(() if config is None else cell_rows(config)),
    ]


def _split(message: str) -> tuple[str, str]:
    """Split a message into what failed and what to do, which is its last sentence or clause."""
    match = re.match(r"(.*\S)(?:[.;]\s+)(\S.*)", message, re.DOTALL)
    return (message, "Correct the file, then run polishd check") if match is None else (match[1], match[2])


# Software.


def installed_version(name: str) -> str | None:
    """Return the version of an installed distribution, None without it."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def software_rows(requires_python: str, classifiers: Iterable[str]) -> Iterator[DoctorRow]:
    """Yield Python's row and polishd's. The tests run on each Python of the classifiers."""
    tested = max(Version(each) for text in classifiers for each in re.findall(r"Python :: (3\.\d+)$", text))
    found = f"{platform.python_version()} ({sys.executable})"
    if sys.version_info[:2] > tested.release:
        yield DoctorRow("Python", "warning", f"{found}; newer than the tested ones", f"Use Python {tested}")
    else:
        yield DoctorRow("Python", "ok", f"{found}; {requires_python} is needed")
    yield DoctorRow("polishd", "ok", f"{installed_version('polishd')} ({Path(__file__).parents[1]})")


def _fits(requirement: Requirement, version: str | None) -> bool:
    return version is not None and requirement.specifier.contains(Version(version), prereleases=True)


def _of_extra(requires: Iterable[str], extra: str) -> list[Requirement]:
    """Return the requirements of an extra on this system; of the core for an empty name."""
    every = [Requirement(text) for text in requires]
    core = {str(one) for one in every if one.marker is None or one.marker.evaluate({"extra": ""})}
    if not extra:
        return [one for one in every if str(one) in core]
    return [one for one in every if str(one) not in core and one.marker and one.marker.evaluate({"extra": extra})]


def dependency_rows(requires: Sequence[str], version_of: VersionOf) -> Iterator[DoctorRow]:
    """Yield a problem for each dependency that is missing or of another version; one row if there is none."""
    core = _of_extra(requires, "")
    wrong = [one for one in core if not _fits(one, version_of(one.name))]
    for one in wrong:
        found = version_of(one.name)
        needed = f"{one.name}{one.specifier}"
        what = "not installed" if found is None else f"{found} does not fit {one.specifier}"
        yield DoctorRow(f"dependency {one.name}", "problem", what, f"Run: pip install '{needed}'")
    if not wrong:
        yield DoctorRow("dependencies", "ok", f"all {len(core)} are installed in a version that fits")


def extra_rows(requires: Sequence[str], version_of: VersionOf, needed: Iterable[str] = ()) -> Iterator[DoctorRow]:
    """Yield a row for each extra but ``all``; a missing one is a problem only if the cell needs it."""
    extras = {name for text in requires for name in re.findall(r"extra == ['\"]([^'\"]+)", text)}
    for extra in sorted(extras - {"all"}):
        parts = _of_extra(requires, extra)
        missing = [one for one in parts if not _fits(one, version_of(one.name))]
        install = f"pip install 'polishd[{extra}]'"
        if not missing:
            found = ", ".join(f"{one.name} {version_of(one.name)}" for one in parts)
            yield DoctorRow(f"extra {extra}", "ok", found)
        elif extra in needed:
            what = f"the cell needs it; not installed: {', '.join(one.name for one in missing)}"
            yield DoctorRow(f"extra {extra}", "problem", what, f"Run: {install}")
        else:
            yield DoctorRow(f"extra {extra}", "ok", "not installed; optional", f"To use it, run: {install}")


def compiled_rows() -> Iterator[DoctorRow]:
    """Yield the row of the compiled functions; none without a compiler."""
    if not has_compiler():
        return
    if is_compiled_ahead():
        yield DoctorRow("compiled code", "ok", "compiled ahead for this user")
    else:
        what = "not compiled ahead: the first large plan of this user takes 15 s longer"
        yield DoctorRow("compiled code", "ok", what, "To compile it now, run: polishd doctor --compile")


# Permissions.


def serial_row(ports: Sequence[str], groups: Sequence[int]) -> DoctorRow:
    """Return the row of the serial ports; without a port that of the group that usually owns them."""
    if closed := [port for port in ports if not os.access(port, os.R_OK | os.W_OK)]:
        group = grp.getgrgid(Path(closed[0]).stat().st_gid).gr_name
        todo = f"Run: sudo usermod -aG {group} {getpass.getuser()}, then log in again"
        return DoctorRow("serial ports", "warning", f"no permission for {', '.join(closed)}", todo)
    if ports:
        return DoctorRow("serial ports", "ok", f"may open {', '.join(ports)}")
    try:
        owner = grp.getgrnam(SERIAL_GROUP).gr_gid
    except KeyError:  # another system
        return DoctorRow("serial ports", "ok", "there is none on this computer")
    if os.getuid() == 0 or owner in groups:
        return DoctorRow("serial ports", "ok", f"there is none now; this user may open those of group {SERIAL_GROUP}")
    what = f"there is none now; user {getpass.getuser()} is not in group {SERIAL_GROUP}"
    return DoctorRow(
        "serial ports", "warning", what, f"Run: sudo usermod -aG {SERIAL_GROUP} {getpass.getuser()}, then log in again"
    )


def can_row(interfaces: Path) -> DoctorRow:
    """Return the row of the CAN interfaces, which polishd reaches through a socketcand server."""
    names = can_interfaces(interfaces)
    if not names:
        return DoctorRow("CAN", "ok", "there is no CAN interface; slcan adapters and socketcand servers need none")
    flags = {name: int((interfaces / name / "flags").read_text(), 16) for name in names}
    if down := [name for name in names if not flags[name] & 1]:  # IFF_UP
        todo = f"Run: sudo ip link set {down[0]} up type can bitrate 500000"
        return DoctorRow("CAN", "warning", f"{', '.join(down)} is down", todo)
    return DoctorRow("CAN", "ok", f"{', '.join(names)}: up; socketcand serves them")


def priority_rows(granted: PriorityResult) -> Iterator[DoctorRow]:
    """Yield the rows of priority and memory lock for the contact loop."""
    found = f"{granted.cores} cores"
    if granted.first:
        yield DoctorRow("priority", "ok", f"contact loop at nice {LOOP_NICE}, {found}")
    else:
        todo = f"Set LimitNICE={LOOP_NICE} in the service, or 'nice {LOOP_NICE}' in limits.conf (docs/how-to/host.md)"
        yield DoctorRow("priority", "warning", f"nice {LOOP_NICE} is not allowed, {found}", todo)
    if granted.locked:
        yield DoctorRow("memory", "ok", "can be locked against swapping")
    else:
        todo = "Set LimitMEMLOCK=infinity in the service, or 'memlock unlimited' in limits.conf (docs/how-to/host.md)"
        yield DoctorRow("memory", "warning", "may be swapped out", todo)


def systemd_rows(root: Path, uid: int, user: str) -> Iterator[DoctorRow]:
    """Yield the rows of the system's systemd and of the user's."""
    if not (root / "run/systemd/system").is_dir():
        todo = "Run the daemon under another supervisor, such as a container that restarts it (docs/how-to/host.md)"
        yield DoctorRow("systemd", "warning", "does not run on this computer", todo)
        return
    yield DoctorRow("systemd", "ok", "runs; polishd service install CELL.toml --system (as root)")
    if uid == 0:
        return
    if not (root / f"run/user/{uid}/systemd").is_dir():
        yield DoctorRow("systemd, user", "warning", f"no session of {user}", "Log in to a session, or use --system")
    elif not (root / f"var/lib/systemd/linger/{user}").exists():
        what = f"services of {user} end when the session ends"
        yield DoctorRow("systemd, user", "warning", what, f"Run: sudo loginctl enable-linger {user}")
    else:
        yield DoctorRow("systemd, user", "ok", f"runs without a session of {user}")


# Clock.


def clock_rows() -> Iterator[DoctorRow]:
    """Yield the rows of synchronization, monotonic clock and time zone."""
    state = _adjtimex()
    if state == UNSYNCHRONIZED:
        what = "not synchronized: times of maps and of other computers cannot be compared"
        yield DoctorRow("clock", "warning", what, "Run: sudo timedatectl set-ntp true")
    else:
        yield DoctorRow("clock", "ok", "synchronized" if state >= 0 else "synchronization is unknown on this system")
    resolution_s = time.get_clock_info("monotonic").resolution
    found = f"resolution {resolution_s * 1e9:g} ns"
    if resolution_s > COARSEST_S:
        yield DoctorRow("monotonic clock", "problem", found, "Use a computer whose clock resolves 1 ms")
    else:
        yield DoctorRow("monotonic clock", "ok", found)
    now = datetime.now().astimezone()
    yield DoctorRow("time zone", "ok", f"{now.tzname()} ({now:%z}); journals have UTC")


def _adjtimex() -> int:
    """Return the kernel's state of the clock; -1 where it cannot be read."""
    adjtimex = getattr(ctypes.CDLL(None), "adjtimex", None)
    return -1 if adjtimex is None else int(adjtimex(ctypes.create_string_buffer(512)))  # modes 0: only read


# Disk.


def disk_rows(state_dir: Path, run_dir: Path) -> Iterator[DoctorRow]:
    """Yield the row of the state folder, and of the run folder if it is another one."""
    state, run = free_space(state_dir.absolute(), run_dir.absolute(), SpaceNeeded.of(0))
    yield _disk_row("state folder", state)
    if run_dir != state_dir:
        yield _disk_row("run folder", run)


def _disk_row(name: str, room: FreeSpace) -> DoctorRow:
    inodes = "" if room.left_files is None else f", {room.left_files} free inodes"
    found = f"{room.folder}: {room.left_mb:.0f} MB free{inodes}"
    code = DeviceError.exit_code
    if not os.access(room.folder, os.W_OK | os.X_OK):
        todo = f"Run: sudo chown {getpass.getuser()} {room.folder}, or set another folder"
        return DoctorRow(name, "problem", f"{found}; no permission to write", todo)
    if not room.has_inodes:
        return DoctorRow(name, "problem", found, f"Delete files: {room.needed_files} free inodes are needed", code)
    if not room.fits:
        return DoctorRow(name, "problem", found, f"Make room: {room.needed_mb:.0f} MB are needed", code)
    return DoctorRow(name, "ok", found)


# A cell.


def cell_rows(config: CellConfig) -> Iterator[DoctorRow]:
    """Yield the rows of a cell: its file, its plugins, and the address of each device."""
    yield DoctorRow("cell", "ok", f"{config.cell.name} ({config.path})")
    for refused in plugins_of(config).report.refused:
        todo = f"Install or correct the plugin, or remove it from plugins.load of {config.path.name}"
        yield DoctorRow(f"plugin {refused.name}", "problem", refused.reason, todo)
    for device, section in config.devices.items():
        keys = section.model_extra or {}
        if isinstance(address := keys.get("address"), str):
            yield address_row(device, address, config.path.parent)
        elif isinstance(folder := keys.get("folder"), str):
            yield _folder_row(device, config.resolve(folder))
        else:
            yield DoctorRow(device, "ok", f"{section.type}: no address in the file")


def address_row(device: str, text: str, base_dir: Path) -> DoctorRow:
    """Return the row of a device's address: whether the port is there, or the host has an address. Opens nothing."""
    match = re.match(r"([a-z.+]+)://([^/:]+)", text)
    if match is not None and match[1] not in {"tcp", "socketcand"}:  # of a plugin or an extra
        return _host_row(device, text, match[2])
    try:
        address = parse_address(text, base_dir)
    except ConfigError as error:
        return DoctorRow(device, "problem", str(error), f"Correct {device}.address")
    match address:
        case SerialLine(path=path) | SlcanAddress(path=path):
            return _port_row(device, text, path)
        case Tcp(host=host) | SocketcandAddress(host=host):
            return _host_row(device, text, host)


def _port_row(device: str, text: str, path: Path) -> DoctorRow:
    code = DeviceError.exit_code
    if not path.exists():
        todo = f"Connect the device, or correct {device}.address (polishd init lists the ports)"
        return DoctorRow(device, "problem", f"{text}: there is no {path}", todo, code)
    if not stat.S_ISCHR(path.stat().st_mode):
        return DoctorRow(device, "problem", f"{text}: {path} is no port", f"Correct {device}.address", code)
    if not os.access(path, os.R_OK | os.W_OK):
        group = grp.getgrgid(path.stat().st_gid).gr_name
        todo = f"Run: sudo usermod -aG {group} {getpass.getuser()}, then log in again"
        return DoctorRow(device, "problem", f"{text}: no permission", todo, code)
    return DoctorRow(device, "ok", f"{text}: the port is there")


def _host_row(device: str, text: str, host: str) -> DoctorRow:
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0][4][0]
    except OSError as error:
        todo = f"Correct {device}.address, or the name service of this computer"
        return DoctorRow(
            device, "problem", f"{text}: {host} has no address: {error.strerror}", todo, DeviceError.exit_code
        )
    shown = "" if found == host else f" ({found})"
    return DoctorRow(device, "ok", f"{text}{shown}: not connected; polishd probe CELL.toml connects")


def _folder_row(device: str, folder: Path) -> DoctorRow:
    if not folder.is_dir():
        todo = f"Mount or create it, or correct {device}.folder"
        return DoctorRow(device, "problem", f"{folder}: is no folder", todo, DeviceError.exit_code)
    if not os.access(folder, os.R_OK | os.W_OK | os.X_OK):
        todo = f"Give user {getpass.getuser()} the permission to read and write it"
        return DoctorRow(device, "problem", f"{folder}: no permission", todo, DeviceError.exit_code)
    return DoctorRow(device, "ok", f"{folder}: may be read and written")
