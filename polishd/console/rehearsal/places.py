"""Where a rehearsal is written: nowhere near what the real cell writes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from polishd.config.cell import CellConfig
from polishd.console.rehearsal.draft import RehearsalDraft
from polishd.files import require_writable
from polishd.model.devices import port_of
from polishd.model.errors import ConfigError

FOLDER_KEYS = ("folder", "claimed", "refused", "program_dir")
"""Options of devices that name folders which somebody writes into."""


def usual_folder(config: CellConfig) -> Path:
    """Beside the state folder."""
    return config.state_dir.parent / f"{config.path.stem}-rehearsal"


def require_apart(draft: RehearsalDraft, out: Path) -> None:
    """ConfigError where the folder holds, or lies in, what the real cell writes; or where something is in it."""
    mine = out.resolve()
    for what, folder in _of_the_cell(draft):
        theirs = folder.resolve()
        if mine == theirs or mine in theirs.parents or theirs in mine.parents:
            raise ConfigError(
                f"{out}: is, holds or lies in {what} of the real cell ({folder}), which a rehearsal never writes "
                "into; name another folder with --out"
            )
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ConfigError(
            f"{out}: is there already; start that rehearsal with polishd sim {out / 'sim.toml'}, or name a new folder "
            "with --out"
        )
    require_writable(out)


def _of_the_cell(draft: RehearsalDraft) -> Iterator[tuple[str, Path]]:
    config = draft.config
    yield "the state folder", config.state_dir
    if config.run_dir is not None:
        yield "the run folder", config.run_dir
    for device in config.devices:
        options = draft.options(device)
        for key in FOLDER_KEYS:
            if options.get(key) is not None:
                yield f"{device}.{key}", _folder(config, device, key, options)
        kind, _, rest = str(options.get("delivery", "")).partition(":")
        if kind == "folder" and rest:
            yield f"{device}.delivery", config.resolve(rest)


def _folder(config: CellConfig, device: str, key: str, options: dict[str, Any]) -> Path:
    """What such a key names; folders of maps taken or refused lie in that of the maps."""
    named = str(options[key])
    if port_of(device) == "metrology" and key != "folder":
        return config.resolve(str(options["folder"])) / named
    return config.resolve(named)
