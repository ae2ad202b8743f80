"""A cell's configuration: TOML into frozen models, each error with its file, line and key."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ValidationError

from polishd.config.document import parse_toml
from polishd.config.physics import PartDocument
from polishd.config.places import Source, did_you_mean, key_lines, listed, problems
from polishd.config.sections import (
    CellSection,
    DeviceSection,
    DwellSection,
    InstrumentSection,
    JobSection,
    LimitsSection,
    MachineSection,
    PluginsSection,
    ProgramSection,
)
from polishd.config.tables import read_tif
from polishd.config.values import Texts
from polishd.hookspecs import DeviceType
from polishd.model.errors import ConfigError
from polishd.model.limits import Envelope
from polishd.model.process import MeasuredTif

PortSection = Literal["robot", "actuator", "spindle", "metrology"]


class CellConfig(PartDocument):
    """All of a cell's configuration; made by ``load_config``."""

    include: Texts = ()
    """Fragments, such as those of `polishd calibrate`, laid over this file in turn: what they say replaces it."""
    cell: CellSection
    plugins: PluginsSection
    robot: DeviceSection
    actuator: DeviceSection
    spindle: DeviceSection
    metrology: DeviceSection
    instrument: InstrumentSection = InstrumentSection()
    program: ProgramSection
    machine: MachineSection
    dwell: DwellSection = DwellSection()
    job: JobSection
    limits: LimitsSection = LimitsSection()

    @property
    def path(self) -> Path:
        """The file it came from, absolute."""
        return self._path

    @property
    def state_dir(self) -> Path:
        """Journal, lock, socket and log; one daemon per folder."""
        return self.resolve(self.cell.state_dir)

    @property
    def run_dir(self) -> Path | None:
        """Where the run folder is wanted, or None for ``state_dir/runs/<job>-<time>``."""
        return None if self.cell.run_dir is None else self.resolve(self.cell.run_dir)

    @property
    def dialect_paths(self) -> list[Path]:
        """Program dialects of the user's own."""
        return [self.resolve(path) for path in self.program.dialects]

    @property
    def program_path(self) -> Path:
        """The part program."""
        return self.resolve(self.program.path)

    @property
    def profile_path(self) -> Path | None:
        """The instrument's profile, or None where the cell names none."""
        return None if self.instrument.profile is None else self.resolve(self.instrument.profile)

    @property
    def sha256(self) -> str:
        """Hash of all values in force, overrides and defaults included."""
        return hashlib.sha256(json.dumps(self.effective(), sort_keys=True).encode()).hexdigest()

    def effective(self) -> dict[str, Any]:
        """All values in force, JSON-ready."""
        return self.model_dump(mode="json")

    @property
    def included(self) -> dict[str, str]:
        """Dotted keys that came from an included fragment, and the file."""
        parts = self._source.included
        return {".".join(map(str, key)): part.file for part in parts for key in key_lines(part.text) if key[1:]}

    def measured_tif(self) -> MeasuredTif | None:
        """The cell's measured TIF, where it names one; ConfigError where that cannot be read."""
        return None if self.process.tif is None else read_tif(self.resolve(self.process.tif))

    def envelope(self) -> Envelope:
        """Limits of machine and process."""
        return Envelope(
            **self.machine.model_dump(),
            max_removal_nm=self.limits.max_removal_nm,
            max_pass_s=self.limits.max_pass_s,
        )


def load_config(path: Path, overrides: Mapping[str, Any] | None = None) -> CellConfig:
    """Read a cell's TOML; ``overrides`` are values by dotted key, such as ``{"process.correction": "none"}``.

    The fragments that ``include`` names are laid over it: what they say replaces what the file says.
    Raises ConfigError with one line per problem: ``FILE:LINE: section.key: what is wrong; what to do``.
    """
    raw, source = parse_toml(path)
    fragments = [parse_toml(path.parent / Path(name).expanduser()) for name in _included(raw, source)]
    source = replace(source, overrides=frozenset(overrides or {}), included=tuple(part for _, part in fragments))
    for fragment, part in fragments:
        if "include" in fragment:
            raise ConfigError(part.error(("include",), "a fragment includes no other; name all in the cell's file"))
        _lay_over(raw, fragment)
    for key, value in (overrides or {}).items():
        _override(raw, key, value, source)
    return CellConfig.of(raw, source)


def device_options(
    config: CellConfig, section: PortSection, device_types: Mapping[str, DeviceType]
) -> tuple[DeviceType, Any]:
    """The device type that a section names, and the section's other keys as that type's options model."""
    raw: DeviceSection = getattr(config, section)
    fitting = {name for name, kind in device_types.items() if kind.port == section}
    kind = device_types.get(raw.type)
    if kind is None:
        raise config.error(
            f"{section}.type",
            f"unknown type {raw.type!r}{did_you_mean(raw.type, fitting)} The loaded plugins have: {listed(fitting)}; "
            "a type of another plugin needs that plugin in plugins.load",
        )
    if kind.port != section:
        raise config.error(f"{section}.type", f"{raw.type!r} is a kind of {kind.port}; use one of {listed(fitting)}")
    options: type[BaseModel] = kind.options
    given = dict(raw.model_extra or {})
    found = _unknown_options(config, section, options, given)
    try:
        value = options.model_validate(given)
    except ValidationError as error:
        found += [line for line in problems(error, options, config.source, (section,)) if line not in found]
    else:
        if not found:
            return kind, value
    raise ConfigError("\n".join(found))


def _unknown_options(
    config: CellConfig, section: PortSection, options: type[BaseModel], given: Mapping[str, Any]
) -> list[str]:
    """Unknown keys are errors also where the plugin's model would let them pass."""
    if options.model_config.get("extra") == "allow":
        return []
    known = {field.alias or name for name, field in options.model_fields.items()}
    return [
        config.source.error((section, key), f"unknown key{did_you_mean(key, known)} Known here: {listed(known)}")
        for key in given
        if key not in known
    ]


def _included(raw: Mapping[str, Any], source: Source) -> list[str]:
    names = raw.get("include", [])
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise ConfigError(source.error(("include",), 'must be a list of file names, such as ["calibration.toml"]'))
    return names


def _lay_over(raw: dict[str, Any], fragment: Mapping[str, Any]) -> None:
    """Keys of the fragment's tables replace those of the file's."""
    for name, value in fragment.items():
        if isinstance(value, dict) and isinstance(raw.get(name), dict):
            _lay_over(raw[name], value)
        else:
            raw[name] = value


def _override(raw: dict[str, Any], key: str, value: Any, source: Source) -> None:
    *tables, last = key.split(".")
    inner = raw
    for name in tables:
        inner = inner.setdefault(name, {})
        if not isinstance(inner, dict):
            raise ConfigError(source.error(tuple(key.split(".")), f"{name!r} is no section; mend the override"))
    inner[last] = value
