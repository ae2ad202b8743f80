"""``polishd service``: a unit of systemd that runs a cell, or several, unattended, or what runs beside their daemon."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from pathlib import Path

import typer

from polishd.console.service_beside import Beside, unit_beside
from polishd.console.systemd import HARDENED, NETWORK, PROTECTED, command_line, target
from polishd.console.who import account
from polishd.daemon.assembly import build_cell
from polishd.daemon.events import DRAIN_S
from polishd.files import write_atomic
from polishd.hooks.cell import load_cell
from polishd.model.errors import ConfigError, DeviceError
from polishd.show.terminal import say

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
        account=f"User={account(owner)}\n" if system and owner else "",
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
