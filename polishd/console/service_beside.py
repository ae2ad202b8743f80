"""Units of systemd for what runs beside a cell's daemon, and for a shop's server: each a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from polishd.config.cell import load_config
from polishd.config.shop import load_shop
from polishd.console.systemd import HARDENED, NETWORK, PROTECTED, command_line, target
from polishd.console.who import account
from polishd.model.errors import ConfigError

Beside = Literal["web", "opcua", "shop-link", "shop-serve"]

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
    "shop-link": _Process(("shop", "link"), _link),
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
        account=f"User={account(owner)}\n" if system and owner else "",
        wrong_use=WRONG_USE,
        wrong_file=ConfigError.exit_code,
        network=NETWORK if system else "",
        hardened=HARDENED,
        system=SERVER_SYSTEM_LINES + PROTECTED if system else "",
        target=target(system=system),
    )
    return f"{process}-{name}", text
