"""``polishd service``: systemd units for the daemon of one or several cells, and for the servers besides it."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import typer

from polishd.config.cell import load_config
from polishd.config.server_sections import load_shop
from polishd.daemon.assembly import build_cell
from polishd.daemon.runtime.events import DRAIN_S
from polishd.model.errors import ConfigError, DeviceError
from polishd.plugin_loader import load_cell
from polishd.rendering.terminal import say
from polishd.util.command_line import account_name
from polishd.util.files import write_atomic

# Common parts of all systemd units: command lines, and the target.

NETWORK = """\
After=network-online.target
Wants=network-online.target
"""
HARDENED = """\
NoNewPrivileges=yes
LockPersonality=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
SystemCallArchitectures=native
"""
PROTECTED = """\
ProtectSystem=full
ProtectControlGroups=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
"""
"""Lines for the system's systemd only."""


def command_line(words: Iterable[str]) -> str:
    """Return the command line of ``ExecStart``: this Python's polishd with these arguments."""
    return " ".join([quoted(sys.executable, executable=True), *map(quoted, ("-m", "polishd", *words))])


def target(*, system: bool) -> str:
    """Return the target that starts the unit at each boot or at each login."""
    return "multi-user.target" if system else "default.target"


def quoted(word: str, *, executable: bool = False) -> str:
    """Quote one argument of ``ExecStart``: systemd expands escapes, ``%`` and, except in the program's path, ``$``.

    Raise ConfigError for a control character, which a unit cannot contain.
    """
    if re.search(r"[\x00-\x1f\x7f]", word):
        raise ConfigError(f"{word!r}: a systemd unit cannot contain this name; rename the file")
    text = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%")
    text = text if executable else text.replace("$", "$$")
    return text if re.fullmatch(r"[\w./+=:@,-]+", text, re.ASCII) else f'"{text}"'


# Units for the servers besides a cell's daemon, and for a shop's server: one process each.

Beside = Literal["web", "opcua", "shop-connect", "shop-serve"]

WRONG_USE = 2
"""Exit code of a wrong command line."""

SERVER_UNIT = """\
[Unit]
Description=polishd {what}: {name}
{network}StartLimitIntervalSec=0

[Service]
Type=exec
ExecStart={command}
{account}\
# It moves nothing, and keeps all its data on disk. A wrong file or command line (3, 2) would end it again.
Restart=always
RestartPreventExitStatus={wrong_use} {wrong_file}
RestartSec=10
# The daemon's weight is 1000.
CPUWeight=20
{hardened}\
{system}\

[Install]
WantedBy={target}
"""

SERVER_SYSTEM_LINES = """\
OOMScoreAdjust=500
"""
"""Lines for the system's systemd only. If memory runs out, the system ends the daemon last."""


@dataclass(frozen=True, slots=True)
class _Process:
    words: tuple[str, ...]
    """Its command, before the file."""
    name: Callable[[Path], str]
    """Return the name in its file; raise ConfigError if the file is wrong, or lacks its section."""


def _opcua(path: Path) -> str:
    config = load_config(path)
    if config.opcua is None:
        raise config.error("opcua", "is missing: add [opcua], docs/how-to/plant-systems.md")
    return config.cell.name


def _link(path: Path) -> str:
    config = load_config(path)
    if config.shop is None:
        raise config.error("shop", "is missing; add [shop]: docs/how-to/shop.md")
    return config.cell.name


PROCESSES: Mapping[Beside, _Process] = {
    "web": _Process(("web",), lambda path: load_config(path).cell.name),
    "opcua": _Process(("opcua",), _opcua),
    "shop-connect": _Process(("shop", "connect"), _link),
    "shop-serve": _Process(("shop", "serve"), lambda path: load_shop(path).shop.name),
}


def unit_beside(process: Beside, path: Path, *, system: bool) -> tuple[str, str]:
    """Return the unit's name and text; raise ConfigError of its file."""
    process_kind = PROCESSES[process]
    name, owner = process_kind.name(path), path.stat().st_uid
    text = SERVER_UNIT.format(
        what=" ".join(process_kind.words),
        name=name.replace("%", "%%"),
        command=command_line([*process_kind.words, str(path.absolute())]),
        account=f"User={account_name(owner)}\n" if system and owner else "",
        wrong_use=WRONG_USE,
        wrong_file=ConfigError.exit_code,
        network=NETWORK if system else "",
        hardened=HARDENED,
        system=SERVER_SYSTEM_LINES + PROTECTED if system else "",
        target=target(system=system),
    )
    return f"{process}-{name}", text


WATCHDOG_S = 30
"""Far longer than the delay after which the daemon leaves contact (docs/how-to/host.md)."""
START_S = 120
"""Time limit until every cell answers."""

DAEMON_UNIT = """\
[Unit]
Description=polishd: {names}
{network}StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
ExecStart={command}
{account}\
WatchdogSec={watchdog}
TimeoutStartSec={start}
TimeoutStopSec={stop}
KillMode=mixed
SuccessExitStatus=1
# A service starts held and moves nothing before polishd resume: at boot, after a kill, after a device error ({device}).
# Any other end needs the operator, so there is no restart.
Restart=on-abnormal
RestartForceExitStatus={device}
RestartSec=10
CPUWeight=1000
{hardened}\
{system}\

[Install]
WantedBy={target}
"""

DAEMON_SYSTEM_LINES = """\
LimitNICE=-10
LimitMEMLOCK=infinity
OOMScoreAdjust=-500
"""
"""Lines for the system's systemd only."""


def show_verb(files: Sequence[Path], *, system: bool, queue: bool, of: Beside | None) -> None:
    """Print the unit; write nothing."""
    say(_requested_unit(files, system=system, queue=queue, of=of)[1], nl=False)


def install_verb(files: Sequence[Path], *, system: bool, queue: bool, of: Beside | None) -> None:
    """Write the unit into systemd's folder, and print how to start it."""
    name, text = _requested_unit(files, system=system, queue=queue, of=of)
    folder = Path("/etc/systemd/system") if system else _user_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_atomic(folder / name, text.encode())
    except OSError as error:
        advice = "run this as root, or install with --user" if system else "check that folder"
        raise ConfigError(f"{folder / name}: cannot be written: {error.strerror}; {advice}") from error
    scope = "" if system else " --user"
    say(f"written: {folder / name}")
    start = f"systemctl{scope} daemon-reload && systemctl{scope} enable --now {name}"
    say(f"start it, now and after each boot: {start}")
    if not system:
        say("to run it also without a login: loginctl enable-linger")


def _requested_unit(files: Sequence[Path], *, system: bool, queue: bool, of: Beside | None) -> tuple[str, str]:
    """Return the name of the unit's file, and its text."""
    if of is None:
        name, text = _unit(files, system=system, queue=queue)
    else:
        if queue or len(files) > 1:
            raise typer.BadParameter(f"--of {of} needs one file, and no --queue: one process serves one file")
        name, text = unit_beside(of, files[0], system=system)
    return f"polishd-{re.sub(r'[^A-Za-z0-9_.]+', '-', name).strip('-')}.service", text


def _unit(cells: Sequence[Path], *, system: bool, queue: bool) -> tuple[str, str]:
    """Return name and text of the unit; raise the errors of ``load_cell``."""
    configs, end_s = [], 0.0
    for path in cells:
        config, hooks = load_cell(path)
        configs.append(config)
        end_s = max(end_s, build_cell(config, hooks).end_s)
    names = [config.cell.name for config in configs]
    words = ["run", *(str(path.absolute()) for path in cells), *["--queue"] * queue, "--start-held"]
    owner = cells[0].stat().st_uid
    text = DAEMON_UNIT.format(
        names=", ".join(names).replace("%", "%%"),
        command=command_line(words),
        account=f"User={account_name(owner)}\n" if system and owner else "",
        watchdog=WATCHDOG_S,
        start=START_S,
        stop=math.ceil(end_s + DRAIN_S + WATCHDOG_S),
        device=DeviceError.exit_code,
        network=NETWORK if system else "",
        hardened=HARDENED,
        system=DAEMON_SYSTEM_LINES + PROTECTED if system else "",
        target=target(system=system),
    )
    return "-".join(names), text


def _user_folder() -> Path:
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "systemd" / "user"
