"""A cell's configuration: TOML into frozen models, each error with its file, line and key."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, PrivateAttr, ValidationError

from polishd.daemon.config_errors import Source, did_you_mean, listed, problems
from polishd.daemon.config_sections import (
    CellSection,
    DeviceSection,
    DwellSection,
    JobSection,
    KinematicsSection,
    LimitsSection,
    MachineSection,
    PartSection,
    PluginsSection,
    ProcessSection,
    ProgramSection,
    Section,
)
from polishd.hookspecs import DeviceType
from polishd.model.errors import ConfigError
from polishd.model.limits import Envelope
from polishd.model.process import HybridRobot, Placement, ToolProcess
from polishd.process.frames import rotation_from_rpy_deg

PortSection = Literal["robot", "actuator", "spindle", "metrology"]


class CellConfig(Section):
    """All of a cell's configuration; made by ``load_config``."""

    cell: CellSection
    plugins: PluginsSection
    robot: DeviceSection
    actuator: DeviceSection
    spindle: DeviceSection
    metrology: DeviceSection
    part: PartSection
    kinematics: KinematicsSection = KinematicsSection()
    process: ProcessSection = ProcessSection()
    program: ProgramSection
    machine: MachineSection
    dwell: DwellSection = DwellSection()
    job: JobSection
    limits: LimitsSection = LimitsSection()
    _path: Path = PrivateAttr(default=Path("cell.toml"))
    _source: Source = PrivateAttr(default=Source("cell.toml", ""))

    @property
    def path(self) -> Path:
        """The file it came from, absolute."""
        return self._path

    @property
    def source(self) -> Source:
        """The text it came from: says where a key stands, for errors."""
        return self._source

    @property
    def base_dir(self) -> Path:
        """Folder that relative paths start from."""
        return self._path.parent

    @property
    def state_dir(self) -> Path:
        """Journal, lock, socket and log; one daemon per folder."""
        return self.resolve(self.cell.state_dir)

    @property
    def run_dir(self) -> Path | None:
        """Where the run folder is wanted, or None for ``state_dir/runs/<job>-<time>``."""
        return None if self.cell.run_dir is None else self.resolve(self.cell.run_dir)

    @property
    def program_path(self) -> Path:
        """The part program."""
        return self.resolve(self.program.path)

    @property
    def sha256(self) -> str:
        """Hash of all values in force, overrides and defaults included."""
        return hashlib.sha256(json.dumps(self.effective(), sort_keys=True).encode()).hexdigest()

    def resolve(self, path: str) -> Path:
        """A path of the configuration, absolute."""
        return self.base_dir / Path(path).expanduser()

    def effective(self) -> dict[str, Any]:
        """All values in force, JSON-ready."""
        return self.model_dump(mode="json")

    def error(self, key: str, problem: str) -> ConfigError:
        """A ConfigError about a dotted key, with its place: for checks that need more than this file."""
        return ConfigError(self._source.error(tuple(key.split(".")), problem))

    def tool_process(self) -> ToolProcess:
        """Tool, contact and Preston constant."""
        return ToolProcess(**{item.name: getattr(self.process, item.name) for item in fields(ToolProcess)})

    def hybrid_robot(self) -> HybridRobot:
        """The robot's geometry and stiffness."""
        return HybridRobot(**{item.name: getattr(self.kinematics, item.name) for item in fields(HybridRobot)})

    def placement(self) -> Placement:
        """Where the part lies in the robot's base frame."""
        return Placement(self.part.origin_mm, rotation_from_rpy_deg(*self.part.rotation_rpy_deg))

    def envelope(self) -> Envelope:
        """Limits of machine and process."""
        return Envelope(
            **self.machine.model_dump(),
            max_removal_nm=self.limits.max_removal_nm,
            max_pass_s=self.limits.max_pass_s,
        )


def load_config(path: Path, overrides: Mapping[str, Any] | None = None) -> CellConfig:
    """Read a cell's TOML; ``overrides`` are values by dotted key, such as ``{"process.correction": "none"}``.

    Raises ConfigError with one line per problem: ``FILE:LINE: section.key: what is wrong; what to do``.
    """
    text = _read(path)
    source = Source(str(path), text, frozenset(overrides or {}))
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(_syntax(path, text, str(error))) from error
    for key, value in (overrides or {}).items():
        _override(raw, key, value, source)
    try:
        config = CellConfig.model_validate(raw)
    except ValidationError as error:
        raise ConfigError("\n".join(problems(error, CellConfig, source))) from error
    config._path = path.absolute()
    config._source = source
    return config


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


def _read(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8").replace("\r\n", "\n")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; name the cell's TOML file") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text (byte {error.start}); save it as UTF-8") from error


def _syntax(path: Path, text: str, message: str) -> str:
    """Place the message of tomllib, which says ``... (at line 3, column 5)`` or ``(at end of document)``."""
    what, _, place = message.partition(" (at ")
    line = place.split()[1].rstrip(",") if place.startswith("line") else str(text.count("\n") + 1)
    return f"{path}:{line}: this is not TOML: {what}; mend that line"


def _override(raw: dict[str, Any], key: str, value: Any, source: Source) -> None:
    *tables, last = key.split(".")
    inner = raw
    for name in tables:
        inner = inner.setdefault(name, {})
        if not isinstance(inner, dict):
            raise ConfigError(source.error(tuple(key.split(".")), f"{name!r} is no section; mend the override"))
    inner[last] = value
