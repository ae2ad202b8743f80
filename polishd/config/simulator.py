"""SIM.toml: what is simulated, and how nasty it is. Its reader is the simulator; the daemon never sees it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, PrivateAttr, model_validator

from polishd.config.cell import load_config, overlay
from polishd.config.fields import Text, as_tuple
from polishd.config.process_sections import HybridSection, KinematicsSection, robot_of
from polishd.config.simulator_cell import CellValues, add_devices, add_physics
from polishd.config.simulator_devices import (
    SimActuatorSection,
    SimForceSensorSection,
    SimInterferometerSection,
    SimLoaderSection,
    SimMonitorSection,
    SimRobotSection,
    SimSpindleSection,
)
from polishd.config.simulator_faults import FaultSection
from polishd.config.simulator_physics import CLOSEST, Effects, Plant, SimContactSection, Truth
from polishd.config.table_files import read_tif
from polishd.config.toml_loader import TomlDocument, TomlSource, key_lines, load_toml
from polishd.model.errors import ConfigError
from polishd.model.process import MeasuredTif, RobotModel
from polishd.util.files import named_path, toml_text


class SimConfig(TomlDocument):
    """The whole of sim.toml."""

    cell: Text | None = None
    """The cell's file. Part, tool, robot, instrument, protocols and addresses are read from it, and times are within
    its limits. A key that is in this file too is the machine's true value. Left out: the defaults of this page."""
    plant: Plant = Plant()
    hidden_truth: Truth = Truth()
    effects: Effects = Effects()
    process: SimContactSection = SimContactSection()
    kinematics: KinematicsSection = HybridSection()
    robot: SimRobotSection = SimRobotSection()
    actuator: SimActuatorSection = SimActuatorSection()
    spindle: SimSpindleSection = SimSpindleSection()
    interferometer: SimInterferometerSection = SimInterferometerSection()
    loader: SimLoaderSection | None = None
    force_sensor: SimForceSensorSection | None = None
    monitor: SimMonitorSection | None = None
    fault: Annotated[tuple[FaultSection, ...], BeforeValidator(as_tuple)] = ()
    _not_simulated: Mapping[str, ConfigError] = PrivateAttr(default_factory=dict)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        radius_mm, tool_mm = self.plant.curvature_radius_mm, self.process.tool_radius_mm
        if radius_mm is not None and tool_mm / radius_mm > CLOSEST:
            raise ValueError(f"plant: into a radius of {radius_mm:g} mm a bonnet of {tool_mm:g} mm does not fit")
        return self

    @property
    def path(self) -> Path:
        """Absolute path of the file."""
        return self._path

    def robot_model(self) -> RobotModel:
        """The robot as it is on paper: `hidden_truth.stiffness` draws what it truly is. ConfigError as of a cell's."""
        return robot_of(self.kinematics, self.resolve)

    def measured_tif(self) -> MeasuredTif | None:
        """What the tool removes, where that was measured; ConfigError where its file is none."""
        name = self.process.tif
        return None if name is None else read_tif(self.file("process.tif", self.resolve(name)))

    def require_simulated(self, devices: Collection[str] | None = None) -> None:
        """Raise ConfigError if one of these devices cannot be simulated as the cell has it; None: any device."""
        for device, error in self._not_simulated.items():
            if devices is None or device in devices:
                raise error


def load_simulator(
    path: Path, model_of: Callable[[Mapping[str, Any]], type[SimConfig]] = lambda _: SimConfig
) -> SimConfig:
    """Read sim.toml and the cell that it names. ``model_of`` returns the model for the sections.

    Raises:
        ConfigError: one line per problem of either file, ``FILE:LINE: section.key: what is wrong; what to do``.
    """
    raw, source, values = _read(path)
    if values is not None:
        add_devices(values)
        raw, source = _laid_over(raw, source, values)
    made = model_of(raw).of(raw, source)
    made._path = path.absolute()
    made._not_simulated = {} if values is None else values.not_simulated
    return made


def require_simulated(path: Path) -> None:
    """Raise ConfigError if a device of the cell that sim.toml names cannot be simulated as the cell has it."""
    _, _, values = _read(path)
    if values is not None:
        add_devices(values)
        for error in values.not_simulated.values():
            raise error


def load_plant(path: Path) -> tuple[dict[str, Any], TomlSource]:
    """Return the sections of sim.toml with the values of its cell, for a plant without links, and their source.

    Raises:
        ConfigError: a file cannot be read, or the cell is invalid.
    """
    raw, source, values = _read(path)
    return (raw, source) if values is None else _laid_over(raw, source, values)


def _read(path: Path) -> tuple[dict[str, Any], TomlSource, CellValues | None]:
    raw, source = load_toml(path)
    named = raw.pop("cell", None)
    if named is None:
        return raw, source, None
    if not isinstance(named, str):
        problem = (
            f"this is a cell's file. Use polishd rehearse {path}"
            if isinstance(named, dict)
            else f"must be the name of a file, not {named!r}. Correct it."
        )
        raise ConfigError(source.error(("cell",), problem))
    cell = named_path(path.parent, named)
    try:
        toml_text(cell)
    except ConfigError as error:
        raise ConfigError(source.error(("cell",), str(error))) from error
    values = CellValues(load_config(cell), path.parent, raw)
    add_physics(values)
    return raw, source, values


def _laid_over(raw: Mapping[str, Any], source: TomlSource, values: CellValues) -> tuple[dict[str, Any], TomlSource]:
    """Return the cell's values with those of sim.toml laid over them, and their source."""
    sections = deepcopy(values.sections)
    overlay(sections, raw)
    cell = values.cell.source
    own = key_lines(source.text)
    elsewhere = tuple((here, there) for here, there in values.locations if here not in own)
    return sections, replace(cell, included=(*cell.included, source), written_at=elsewhere)
