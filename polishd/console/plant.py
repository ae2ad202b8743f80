"""``polishd opcua``: a cell for the systems of its plant."""

from __future__ import annotations

import asyncio
import importlib.util
import os
from pathlib import Path

from polishd.config.cell import load_config
from polishd.model.errors import ConfigError

NICE = 5
"""The server gives way to the daemon, whose loop holds contact."""


def opcua_verb(path: Path) -> None:
    """Until Ctrl-C or SIGTERM. ConfigError where the cell does not say who it is, or the library is missing."""
    config = load_config(path)
    if config.opcua is None:
        raise config.error("opcua", "is missing: an OPC UA client wants to know who this machine is; add [opcua]: "
                           "docs/plant-systems.md")  # fmt: skip
    if importlib.util.find_spec("asyncua") is None:
        raise ConfigError("polishd opcua needs asyncua, which is not installed: pip install 'polishd[opcua]'")
    from polishd.plant.opcua import ADDRESS, serve

    os.nice(NICE)
    try:
        asyncio.run(serve(config.cell.name, config.state_dir, config.opcua))
    except OSError as error:
        taken = f"{ADDRESS}:{config.opcua.port} cannot be listened at: {error.strerror}; choose another"
        raise config.error("opcua.port", taken) from error
