"""``polishd service``: a unit of systemd that runs a cell, or several, unattended, or what runs beside their daemon."""

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

# What all units of systemd share: command lines as it reads them, and where a unit belongs.

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
"""What only the system's own systemd may give."""


def command_line(words: Iterable[str]) -> str:
    """Of ``ExecStart``: this Python's polishd, with those words."""
    return " ".join([quoted(sys.executable, executable=True), *map(quoted, ("-m", "polishd", *words))])


def target(*, system: bool) -> str:
    """What wants it, at each boot or at each login."""
    return "multi-user.target" if system else "default.target"


def quoted(word: str, *, executable: bool = False) -> str:
    """One word of ``ExecStart``: systemd reads escapes, ``%`` and, but in the program's own path, ``$`` in it.

    ConfigError for a line break or another control character, which no unit can hold.
    """
    if re.search(r"[\x00-\x1f\x7f]", word):
        raise ConfigError(f"{word!r}: a unit of systemd cannot name it; rename the file")
    text = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%")
    text = text if executable else text.replace("$", "$$")
    return text if re.fullmatch(r"[\w./+=:@,-]+", text, re.ASCII) else f'"{text}"'


# Units of systemd for what runs beside a cell's daemon, and for a shop's server: each a process of its own.

Beside = Literal["web", "opcua", "shop-connect", "shop-serve"]

WRONG_USE = 2
"""Exit code of a command line that is wrong."""

SERVER_UNIT = """\
[Unit]
Description=polishd {what}: {name}
{network}StartLimitIntervalSec=0

[Service]
Type=exec
ExecStart={command}
{account}\
# It moves nothing, and knows nothing that is not on the disk. Over its file or command line (3, 2) it would end again.
Restart=always
RestartPreventExitStatus={wrong_use} {wrong_file}
RestartSec=10
# The daemon has 1000.
CPUWeight=20
{hardened}\
{system}\

[Install]
WantedBy={target}
"""

SERVER_SYSTEM_LINES = """\
OOMScoreAdjust=500
"""
"""What only the system's own systemd may give. Should memory run out, the daemon is the last to go."""


@dataclass(frozen=True, slots=True)
class _Process:
    words: tuple[str, ...]
    """Of its command line, before the file."""
    name: Callable[[Path], str]
    """Of its file; ConfigError where that is wrong, or has no section for it."""


def _opcua(path: Path) -> str:
    config = load_config(path)
    if config.opcua is None:
        raise config.error("opcua", "is missing: add [opcua], docs/plant-systems.md")
    return config.cell.name


def _link(path: Path) -> str:
    config = load_config(path)
    if config.shop is None:
        raise config.error("shop", "is missing: this cell belongs to no shop; add [shop]: docs/shop.md")
    return config.cell.name


PROCESSES: Mapping[Beside, _Process] = {
    "web": _Process(("web",), lambda path: load_config(path).cell.name),
    "opcua": _Process(("opcua",), _opcua),
    "shop-connect": _Process(("shop", "link"), _link),
    "shop-serve": _Process(("shop", "serve"), lambda path: load_shop(path).shop.name),
}


def unit_beside(process: Beside, path: Path, *, system: bool) -> tuple[str, str]:
    """What its unit is called after, and its text. ConfigError as of the file that it reads."""
    asked = PROCESSES[process]
    name, owner = asked.name(path), path.stat().st_uid
    text = SERVER_UNIT.format(
        what=" ".join(asked.words),
        name=name.replace("%", "%%"),
        command=command_line([*asked.words, str(path.absolute())]),
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
"""Far above what makes the daemon itself leave contact (docs/host.md)."""
START_S = 120
"""Until every cell answers."""

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
# What was killed comes up held, and moves nothing; so does what ended over a device that was not there yet ({device}).
# Any other end is one that a person should look at.
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
"""What only the system's own systemd may give."""


def show_verb(files: Sequence[Path], *, system: bool, queue: bool, of: Beside | None) -> None:
    """Print the unit; nothing is written."""
    say(_asked(files, system=system, queue=queue, of=of)[1], nl=False)


def install_verb(files: Sequence[Path], *, system: bool, queue: bool, of: Beside | None) -> None:
    """Write the unit where systemd finds it, and say how to start it."""
    name, text = _asked(files, system=system, queue=queue, of=of)
    folder = Path("/etc/systemd/system") if system else _user_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_atomic(folder / name, text.encode())
    except OSError as error:
        advice = "run this as root, or install with --user" if system else "look at that folder"
        raise ConfigError(f"{folder / name}: cannot be written: {error.strerror}; {advice}") from error
    scope = "" if system else " --user"
    say(f"written: {folder / name}")
    start = f"systemctl{scope} daemon-reload && systemctl{scope} enable --now {name}"
    say(f"start it, now and after each boot: {start}")
    if not system:
        say("to run while nobody is logged in: loginctl enable-linger")


def _asked(files: Sequence[Path], *, system: bool, queue: bool, of: Beside | None) -> tuple[str, str]:
    """Name of the unit's file, and its text."""
    if of is None:
        name, text = _unit(files, system=system, queue=queue)
    else:
        if queue or len(files) > 1:
            raise typer.BadParameter(f"--of {of} takes one file, and no --queue: each is a process of its own")
        name, text = unit_beside(of, files[0], system=system)
    return f"polishd-{re.sub(r'[^A-Za-z0-9_.]+', '-', name).strip('-')}.service", text


def _unit(cells: Sequence[Path], *, system: bool, queue: bool) -> tuple[str, str]:
    """Name and text of the unit; whatever ``load_cell`` raises of a cell that cannot run."""
    configs, end_s = [], 0.0
    for path in cells:
        config, hooks = load_cell(path)
        configs.append(config)
        end_s = max(end_s, build_cell(config, hooks).end_s)
    names = [config.cell.name for config in configs]
    words = ["run", *(str(path.absolute()) for path in cells), *["--queue"] * queue]
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
