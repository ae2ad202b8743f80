"""``polishd service``: a unit of systemd that runs a cell, or several, unattended."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path

import typer

from polishd.console.who import account
from polishd.daemon.assembly import build_cell
from polishd.daemon.events import DRAIN_S
from polishd.files import write_atomic
from polishd.hooks.cell import load_cell
from polishd.model.errors import ConfigError, DeviceError

WATCHDOG_S = 30
"""Far above what makes the daemon itself leave contact (docs/host.md)."""
START_S = 120
"""Until every cell answers."""

UNIT = """\
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
NoNewPrivileges=yes
LockPersonality=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
SystemCallArchitectures=native
{system}\

[Install]
WantedBy={target}
"""

NETWORK = """\
After=network-online.target
Wants=network-online.target
"""
SYSTEM = """\
LimitNICE=-10
LimitMEMLOCK=infinity
OOMScoreAdjust=-500
ProtectSystem=full
ProtectControlGroups=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
"""
"""What only the system's own systemd may give."""


def show_verb(cells: Sequence[Path], *, system: bool, queue: bool) -> None:
    """Print the unit; nothing is written."""
    typer.echo(_unit(cells, system=system, queue=queue)[1], nl=False)


def install_verb(cells: Sequence[Path], *, system: bool, queue: bool) -> None:
    """Write the unit where systemd finds it, and say how to start it."""
    name, text = _unit(cells, system=system, queue=queue)
    folder = Path("/etc/systemd/system") if system else _user_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_atomic(folder / name, text.encode())
    except OSError as error:
        advice = "run this as root, or install with --user" if system else "look at that folder"
        raise ConfigError(f"{folder / name}: cannot be written: {error.strerror}; {advice}") from error
    scope = "" if system else " --user"
    typer.echo(f"written: {folder / name}")
    start = f"systemctl{scope} daemon-reload && systemctl{scope} enable --now {name}"
    typer.echo(f"start it, now and after each boot: {start}")
    if not system:
        typer.echo("to run while nobody is logged in: loginctl enable-linger")


def _unit(cells: Sequence[Path], *, system: bool, queue: bool) -> tuple[str, str]:
    """Name and text of the unit; whatever ``load_cell`` raises of a cell that cannot run."""
    configs, end_s = [], 0.0
    for path in cells:
        config, hooks = load_cell(path)
        configs.append(config)
        end_s = max(end_s, build_cell(config, hooks).end_s)
    names = [config.cell.name for config in configs]
    words = [sys.executable, "-m", "polishd", "run", *(str(path.absolute()) for path in cells), *["--queue"] * queue]
    owner = cells[0].stat().st_uid
    text = UNIT.format(
        names=", ".join(names).replace("%", "%%"),
        command=" ".join([quoted(words[0], executable=True), *map(quoted, words[1:])]),
        account=f"User={account(owner)}\n" if system and owner else "",
        watchdog=WATCHDOG_S,
        start=START_S,
        stop=math.ceil(end_s + DRAIN_S + WATCHDOG_S),
        device=DeviceError.exit_code,
        network=NETWORK if system else "",
        system=SYSTEM if system else "",
        target="multi-user.target" if system else "default.target",
    )
    return f"polishd-{'-'.join(re.sub(r'[^A-Za-z0-9_.]+', '-', name).strip('-') for name in names)}.service", text


def quoted(word: str, *, executable: bool = False) -> str:
    """One word of ``ExecStart``: systemd reads escapes, ``%`` and, but in the program's own path, ``$`` in it.

    ConfigError for a line break or another control character, which no unit can hold.
    """
    if re.search(r"[\x00-\x1f\x7f]", word):
        raise ConfigError(f"{word!r}: a unit of systemd cannot name it; rename the file")
    text = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%")
    text = text if executable else text.replace("$", "$$")
    return text if re.fullmatch(r"[\w./+=:@,-]+", text, re.ASCII) else f'"{text}"'


def _user_folder() -> Path:
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "systemd" / "user"
