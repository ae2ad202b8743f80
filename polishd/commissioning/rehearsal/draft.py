"""Differences between a rehearsal and its cell, before the files are written; its folder."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, MutableMapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import tomlkit

from polishd.commissioning.rehearsal.simulated_cell import free_port
from polishd.config.cell import FILES, CellConfig, device_options, overlay
from polishd.config.simulator_cell import KINDS, SECTIONS
from polishd.config.toml_loader import join_words
from polishd.drivers.transport.address import SerialLine, SlcanAddress, Tcp, parse_address
from polishd.hookspecs import DeviceType
from polishd.model.devices import port_of
from polishd.model.errors import ConfigError
from polishd.plugin_loader import Hooks, load_own
from polishd.util.files import require_writable
from polishd.util.serialization import toml

LOOPBACK = "127.0.0.1"
REQUEST = "measure.request"
"""File that asks the simulated instrument for a map."""
SIM_STATE = "sim"
"""The simulator's state folder, beside SIM.toml."""


@dataclass(slots=True)
class RehearsalDraft:
    """A rehearsal that is being made of a cell."""

    config: CellConfig
    hooks: Hooks
    sim: dict[str, dict[str, tuple[Any, str]]] = field(default_factory=dict)
    """sim.toml: by section and key a value, and the comment behind it."""
    laid: dict[str, Any] = field(default_factory=dict)
    """Changed values of the rehearsal's cell by dotted key; None: the key is removed."""
    notes: list[str] = field(default_factory=list)
    """Differences between the simulated cell and the real one."""
    files: dict[str, bytes] = field(default_factory=dict)
    """Files that the rehearsal's cell names, by name in the folder."""

    def put(self, section: str, key: str, value: Any, comment: str) -> None:
        """A value of sim.toml, and the comment behind it."""
        self.sim.setdefault(section, {})[key] = (value, comment)

    def options(self, device: str) -> dict[str, Any]:
        """A device's options with their defaults, as its type judges them; ConfigError as of the cell."""
        _, options = device_options(self.config, device, self.hooks.device_types())
        return dict(options)

    def device_type(self, device: str) -> DeviceType:
        """The device's type. ConfigError as of the cell."""
        return device_options(self.config, device, self.hooks.device_types())[0]

    def replace_device(self, device: str, **keys: Any) -> None:
        """Replace a device that has no simulated one by the port's substitute with these keys. Keys of the port stay.

        Raises:
            ConfigError: no simulated device can take its place.
        """
        own, raw = load_own(), self.config.devices[device]
        substitute = own.substitute(port_of(device))
        if substitute is None:
            raise self.config.error(f"{device}.type", f"{raw.type!r} has no simulated device, and no other replaces it")
        kept = {key: getattr(raw, key) for key in type(raw).model_fields if key != "type"}
        self.laid[device] = {**kept, "type": substitute.name, **keys}
        self.notes.append(f"{device}: there is no simulated {raw.type!r}; {substitute.name} replaces it")
        self._load_plugin(own.plugin_of("polishd_device_types", substitute.name))

    def instead(self, key: str, value: Any, why: str) -> None:
        """Replace a value of the cell, with a note; None: the key is left out."""
        self.laid[key] = value
        state = "is left out" if value is None else f"is {json.dumps(value)} in the rehearsal"
        self.notes.append(f"{key}: {why}; it {state}")

    def _load_plugin(self, name: str) -> None:
        loaded = self.laid.get("plugins.load", list(self.config.plugins.load))
        if name not in loaded:
            self.laid["plugins.load"] = [*loaded, name]


def move_address(draft: RehearsalDraft, device: str, address: str) -> None:
    """Give a device an address of the same kind on this computer. Raise ConfigError if its own is not an address."""
    real = parse_address(address, draft.config.base_dir)
    query = urlsplit(address).query
    if isinstance(real, SerialLine | SlcanAddress):
        path = f"{address.partition(':')[0]}:{SIM_STATE}/{port_of(device)}"
        lay_address(draft, device, path + (f"?{query}" if query else ""))
        return
    at = f"{LOOPBACK}:{free_port()}"
    lay_address(draft, device, f"tcp://{at}" if isinstance(real, Tcp) else f"socketcand://{at}/{real.channel}")


def lay_address(draft: RehearsalDraft, device: str, address: str) -> None:
    """Give a device of the rehearsal's cell this address, and its simulated device what the cell does not say."""
    draft.laid[f"{device}.address"] = address
    url = urlsplit(address)
    if put_kind(draft, device, is_serial=url.scheme in {"serial", "slcan"}) and url.port is not None:
        draft.put(port_of(device), "port", url.port, f"{device}.address")


def put_kind(draft: RehearsalDraft, device: str, *, is_serial: bool = False) -> bool:
    """Put the `kind` of another plugin's device into sim.toml. Return False for a type of polishd's.

    Raises:
        ConfigError: its type names a simulated device with several protocols.
    """
    own, one = load_own(), draft.device_type(device)
    if one.name in KINDS:
        return False
    same = [name for name, shipped in own.device_types().items() if is_like(shipped, one)]
    kinds = {KINDS[name][not is_serial] for name in same} - {""}
    if len(kinds) > 1 or (same and not kinds):
        several = sorted({kind for name in same for kind in KINDS[name]} - {""})
        raise draft.config.error(
            f"{device}.type",
            f"{one.name!r} is simulated by {one.simulated_by!r}, which has several protocols; the plugin must name one "
            f"as simulated_by: {join_words(several)}",
        )
    draft.put(SECTIONS.get(one.port, one.port), "kind", kinds.pop() if kinds else one.simulated_by, f"{device}.type")
    return True


def is_like(shipped: DeviceType, one: DeviceType) -> bool:
    """Return whether a type of polishd's has the simulated device of another."""
    return shipped.name in KINDS and (shipped.port, shipped.simulated_by) == (one.port, one.simulated_by)


# The two files as text: sim.toml, and the cell's own file with few of its values.

COLUMN = 45
"""In which comments begin, where a value leaves room."""


def sim_text(draft: RehearsalDraft, cell: str) -> str:
    """Return sim.toml for the rehearsal's cell, which has that file name."""
    lines = [
        f"# Made by polishd rehearse {draft.config.path}: the simulated cell of {draft.config.cell.name}.",
        "# Other values come from the cell. All keys: docs/reference/simulator.md",
        *(f"# {note}" for note in draft.notes),
        f"cell = {toml(cell)}",
    ]
    for section, values in draft.sim.items():
        lines += ["", f"[{section}]"]
        lines += [f"{f'{key} = {toml(value)}':<{COLUMN}} # {comment}" for key, (value, comment) in values.items()]
    return "\n".join(lines) + "\n"


def cell_text(draft: RehearsalDraft) -> str:
    """The rehearsal's cell: the cell with its fragments laid over it, its files by absolute paths, and its changes."""
    config = draft.config
    document = tomlkit.parse(config.source.text)
    if document.pop("include", None):  # what fragments say would replace what is changed here
        overlay(document, {key: value for key, value in config.raw.items() if key != "include"})
    for key, value in {**_files(draft), **draft.laid}.items():
        _set(document, key.split("."), value)
    head = f"# Made by polishd rehearse {config.path}: the same cell, with simulated devices and separate folders.\n"
    return head + "".join(f"# {note}\n" for note in draft.notes) + tomlkit.dumps(document)


def _files(draft: RehearsalDraft) -> dict[str, Any]:
    """Keys of the cell that name files, with absolute paths: the rehearsal's cell lies in another folder."""
    found: dict[str, Any] = {}
    for key in FILES:
        section, name = key.split(".")
        given = draft.config.raw.get(section, {}).get(name)
        if isinstance(given, str):
            found[key] = str(draft.config.resolve(given).absolute())
        elif given:
            found[key] = [str(draft.config.resolve(one).absolute()) for one in given]
    return found


def _set(table: MutableMapping[str, Any], path: list[str], value: Any) -> None:
    """Set, or with None take out, what a dotted key names; tables on the way are made."""
    *way, last = path
    for name in way:
        if name not in table:
            if value is None:
                return
            table[name] = tomlkit.table()
        table = table[name]
    if value is None:
        table.pop(last, None)
    elif isinstance(value, Mapping):
        made = tomlkit.table()
        for key, one in value.items():
            made[key] = one
        table[last] = made
    else:
        table[last] = value


# Where a rehearsal is written: nowhere near what the real cell writes.

FOLDER_KEYS = ("folder", "claimed_dir", "refused_dir", "program_dir")
"""Options of devices that name folders for files of other programs."""


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
