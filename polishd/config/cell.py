"""A cell's configuration: TOML into frozen models, each error with its file, line and key."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ValidationError

from polishd.config.cell_sections import (
    BetweenSection,
    CellSection,
    CertificateSection,
    DeviceInterface,
    DeviceSection,
    DwellSection,
    ForceSensorSection,
    InstrumentSection,
    JobSection,
    LimitsSection,
    MachineSection,
    MemorySection,
    NotifySection,
    PluginsSection,
    ProgramSection,
    RippleSection,
    RobotSection,
    SignalSection,
    TouchOffSection,
)
from polishd.config.fields import Name, Texts, as_tuple, require_cells
from polishd.config.process_sections import ToolSection, tool_overlay
from polishd.config.renamed_keys import RENAMED_TYPES, TYPE_ADVICE, renamed_key
from polishd.config.server_sections import ServedDocument
from polishd.config.table_files import read_tif
from polishd.config.tolerance import ToleranceSection, lines_of
from polishd.config.toml_loader import (
    Location,
    TomlSource,
    did_you_mean,
    join_words,
    key_lines,
    load_toml,
    validation_problems,
)
from polishd.hookspecs import DeviceType, NotifierType
from polishd.interfaces import ForceActuator, ForceSensor, Metrology, Monitor, PartLoader, Robot, Spindle
from polishd.model.devices import port_of
from polishd.model.dwell import AS_PROGRAMMED
from polishd.model.errors import ConfigError
from polishd.model.process import MeasuredTif
from polishd.model.program import Envelope
from polishd.model.tolerance import ToleranceLine
from polishd.util.files import named_path


class CellConfig(ServedDocument):
    """All of a cell's configuration; made by ``load_config``."""

    include: Texts = ()
    """Files laid over this one in order, such as those of `polishd calibrate`. Their values replace those here."""
    cell: CellSection
    plugins: PluginsSection
    # Ports, in the order in which their devices are opened. This is the only list of them.
    actuator: Annotated[DeviceSection, DeviceInterface(ForceActuator)]
    robot: Annotated[RobotSection, DeviceInterface(Robot)]
    spindle: Annotated[DeviceSection, DeviceInterface(Spindle)]
    metrology: Annotated[DeviceSection, DeviceInterface(Metrology, acts=False, of_part=True)]
    loader: Annotated[DeviceSection | None, DeviceInterface(PartLoader)] = None
    force_sensor: Annotated[ForceSensorSection | None, DeviceInterface(ForceSensor, acts=False)] = None
    monitor: Annotated[DeviceSection | None, DeviceInterface(Monitor, acts=False, chosen=False)] = None
    signals: Mapping[Name, SignalSection] = {}
    roles: Mapping[str, Name] = {}
    """Which of several devices at a port the job uses: ``robot = "left"``."""
    instrument: InstrumentSection = InstrumentSection()
    program: ProgramSection
    machine: MachineSection
    dwell: DwellSection = DwellSection()
    ripple: RippleSection = RippleSection()
    touch_off: TouchOffSection | None = None
    part_handling: BetweenSection = BetweenSection()
    tools: Mapping[Name, ToolSection] = {}
    """Tools that polish the part one after another, in this order. Left out: the tool of `[process]`."""
    job: JobSection
    estimates: MemorySection = MemorySection()
    tolerance: Annotated[tuple[ToleranceSection, ...], BeforeValidator(as_tuple)] = ()
    limits: LimitsSection = LimitsSection()
    notify: Mapping[Name, NotifySection] = {}
    certificate: CertificateSection = CertificateSection()

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
        """Configured run folder, or None for ``state_dir/runs/<job>-<time>``."""
        return None if self.cell.run_dir is None else self.resolve(self.cell.run_dir)

    @property
    def dialect_paths(self) -> list[Path]:
        """Dialect files of the user."""
        return [self.resolve(path) for path in self.program.dialects]

    @property
    def program_paths(self) -> tuple[Path, ...]:
        """The part programs of the tool, in the order in which they take turns from pass to pass."""
        return tuple(map(self.resolve, self.program.paths))

    @property
    def program_path(self) -> Path:
        """The part program of the first pass."""
        return self.program_of_pass(1)

    def program_of_pass(self, number: int) -> Path:
        """The part program of a pass of the tool, counted from 1."""
        return self.program_paths[(number - 1) % len(self.program_paths)]

    @property
    def profile_path(self) -> Path | None:
        """The instrument's profile, or None where the cell names none."""
        return None if self.instrument.profile is None else self.resolve(self.instrument.profile)

    @property
    def devices(self) -> dict[str, DeviceSection]:
        """All devices by name (``robot``, or ``robot.left`` of several), in the order in which they are opened."""
        sections = {port: getattr(self, port) for port in PORTS}
        return {name: one for port, given in sections.items() if given for name, one in given.devices(port).items()}

    @property
    def used(self) -> dict[str, str]:
        """The name of the device that the job uses, by port."""
        return {
            port: f"{port}.{self.roles[port]}" if port in self.roles else port
            for port, mark in PORTS.items()
            if mark.chosen and (port in self.roles or port in self.devices)
        }

    @property
    def lines(self) -> tuple[ToleranceLine, ...]:
        """Tolerance lines that decide whether the part is accepted."""
        return lines_of(self.job, tuple(line for section in self.tolerance for line in section.lines))

    def effective(self) -> dict[str, Any]:
        """All values in force, JSON-ready."""
        return self.model_dump(mode="json")

    @property
    def raw(self) -> Mapping[str, Any]:
        """The values as written, with fragments and overrides applied."""
        return self._raw

    @property
    def included(self) -> dict[str, str]:
        """File of each dotted key that came from an included fragment."""
        parts = self._source.included
        return {".".join(map(str, key)): part.file for part in parts for key in key_lines(part.text) if key[1:]}

    def of_tool(self, name: str) -> CellConfig:
        """Return the cell with only that tool on its spindle. Raise ConfigError if the result is not a valid cell."""
        made = type(self).of(*tool_overlay(self._raw, self._source, name))
        made._path = self._path
        return consistent(made)

    @property
    def turns(self) -> tuple[CellConfig, ...]:
        """The cell once for each of its tools, in polishing order; the cell itself if it has one tool."""
        return tuple(self.of_tool(name) for name in self.tools) or (self,)

    def measured_tif(self) -> MeasuredTif | None:
        """Return the cell's measured TIF, or None if it names none. Raise ConfigError if it cannot be read."""
        name = self.process.tif
        return None if name is None else read_tif(self.file("process.tif", self.resolve(name)))

    def envelope(self) -> Envelope:
        """Limits of machine and process."""
        return Envelope(
            **self.machine.model_dump(),
            max_removal_nm=self.limits.max_removal_nm,
            max_pass_s=self.limits.max_pass_s,
        )


PORTS: Mapping[str, DeviceInterface] = {
    name: mark
    for name, field in CellConfig.model_fields.items()
    for mark in field.metadata
    if isinstance(mark, DeviceInterface)
}
"""Requirements of each port, in the order in which devices are opened."""

FILES = (
    "program.path", "program.dialects", "instrument.profile", "part.polygon_file", "part.form", "process.tif",
    "kinematics.table",
)  # fmt: skip
"""Keys that name files: their content counts, not their location. For the keys of a tool see `tool_files`."""
TOOL_FILES = ("program", "tif")


def tool_files(tools: Mapping[str, Any]) -> list[str]:
    """Return the dotted keys that name files in the tables of tools."""
    return [f"tools.{name}.{key}" for name in tools for key in TOOL_FILES]


def load_config(path: Path, overrides: Mapping[str, Any] | None = None) -> CellConfig:
    """Read a cell's TOML; ``overrides`` are values by dotted key, such as ``{"process.correction": "none"}``.

    Fragments named by ``include`` are laid over it: their values replace those of the file.
    Raises ConfigError with one line per problem: ``FILE:LINE: section.key: what is wrong; what to do``.
    """
    raw, source = load_toml(path)
    fragments = [load_toml(named_path(path.parent, name)) for name in _included(raw, source)]
    source = replace(source, overrides=frozenset(overrides or {}), included=tuple(part for _, part in fragments))
    for fragment, part in fragments:
        if "include" in fragment:
            raise ConfigError(
                part.error(("include",), "a fragment cannot include another; name all fragments in the cell's file")
            )
        overlay(raw, fragment)
    for key, value in (overrides or {}).items():
        _override(raw, key, value, source)
    return consistent(CellConfig.of(raw, source))


def consistent(config: CellConfig) -> CellConfig:
    """Return the config unchanged; raise ConfigError, as ``load_config``, if its sections contradict each other."""
    wrong = (
        *_wrong_force(config),
        *_wrong_grid(config),
        *_wrong_devices(config),
        *_removed(config),
        *_wrong_signals(config),
        *_wrong_tolerance(config),
        *_wrong_tools(config),
        *_wrong_programs(config),
    )
    if found := [str(config.error(key, problem)) for key, problem in wrong]:
        raise ConfigError("\n".join(found))
    return config


def _wrong_force(config: CellConfig) -> Iterator[tuple[str, str]]:
    """Yield (key, problem) of the largest force: it must be above the forces that regulation allows."""
    process, band = config.process, config.limits.force_band
    regular_n = process.force_n * (1.0 + band)
    if process.force_max_n is not None and process.force_max_n <= regular_n:
        problem = (
            f"{process.force_max_n:g} N is within the regulation band: {process.force_n:g} N + {band:.0%} "
            f"(limits.force_band) = {regular_n:g} N. Set it above, or leave it out for 1.5 times process.force_n"
        )
        yield "process.force_max_n", problem


def _wrong_tolerance(config: CellConfig) -> Iterator[tuple[str, str]]:
    """Yield (key, problem) of the tolerance."""
    job, lines = config.job, [line for section in config.tolerance for line in section.lines]
    if job.tolerance_nm is None and not lines:
        yield "job.tolerance_nm", "is missing; add it: tolerance_nm = ..., or the drawing's lines: [[tolerance]]"
    if job.tolerance_nm is not None and lines:
        yield "job.tolerance_nm", "there are [[tolerance]] lines, too; keep one of both (rms_nm in a line is the same)"
    if job.tolerance_period_mm and lines:
        yield (
            "job.tolerance_period_mm",
            "goes with job.tolerance_nm; write periods_above_mm into the [[tolerance]] lines",
        )
    if job.accept_by in {"bound", "bound_without_power"}:
        if config.part.alignment == "piston":
            yield (
                "job.accept_by",
                'part.alignment = "piston" counts the tilt of each map as figure, so there is no bound; use "tilt"',
            )
        if not any(line.bounded for line in config.lines):
            yield (
                "job.accept_by",
                'a bound needs a line with an RMS and without periods_below_mm; add one, or accept_by = "figure"',
            )
    if config.part.alignment == "power" and any(line.figure == "A" for line in lines):
        yield (
            "tolerance",
            '3/A limits the power, which part.alignment = "power" removes; use alignment = "tilt"',
        )


def _wrong_grid(config: CellConfig) -> Iterator[tuple[str, str]]:
    """Yield (key, problem) of the grid. A part whose corners are in a file is checked when that file is read."""
    if config.part.polygon_file is None:
        wide, high = (2 * half for half in config.part.outline.half_mm)
        try:
            require_cells(wide, high, config.process.grid_mm, "process.grid_mm")
        except ValueError as error:
            yield "process.grid_mm", str(error).partition(": ")[2]


def _wrong_tools(config: CellConfig) -> Iterator[tuple[str, str]]:
    """Yield (key, problem) of tools."""
    if not config.tools:
        return
    passes = sum(tool.passes for tool in config.tools.values())
    if passes > config.job.max_cycles:
        yield (
            "job.max_cycles",
            f"is {config.job.max_cycles}, but the tools have {passes} passes; set it to {passes} or more",
        )
    if config.estimates.tool is not None:
        yield "estimates.tool", "[tools] names the tools already; remove the line"
    if config.dwell.objective == AS_PROGRAMMED:
        yield "dwell.objective", f"{AS_PROGRAMMED!r} needs one tool; remove the others from [tools]"
    for name, tool in config.tools.items():
        if tool.position_mm is not None and config.touch_off is None:
            yield f"tools.{name}.position_mm", "needs [touch_off], which is missing; add it, or remove the line"


def _wrong_programs(config: CellConfig) -> Iterator[tuple[str, str]]:
    """Yield (key, problem) of programs that take turns."""
    named = {f"tools.{name}.program": tool.program for name, tool in config.tools.items()}
    for key, names in {"program.path": config.program.path, **named}.items():
        if not isinstance(names, tuple):
            continue
        paths = [config.resolve(name).resolve() for name in names]
        if twice := next((name for at, name in enumerate(names) if paths[at] in paths[:at]), None):
            yield key, f"names {twice!r} twice; the programs take turns from pass to pass, so name each of them once"


def _removed(config: CellConfig) -> Iterator[tuple[str, str]]:
    """Yield (key, problem) of device types of earlier versions."""
    for port, section in ((port, getattr(config, port)) for port in PORTS):
        several = {} if section is None else section.tables
        types = {f"{port}.{name}": keys.get("type") for name, keys in several.items()}
        for name, kind in (types or {port: getattr(section, "type", None)}).items():
            if kind in RENAMED_TYPES:
                new = RENAMED_TYPES[kind]
                yield f"{name}.type", f'{kind!r} was removed or renamed. Write type = "{new}"{TYPE_ADVICE.get(new, "")}'


def _wrong_devices(config: CellConfig) -> Iterator[tuple[str, str]]:
    """Yield (key, problem) of tables of several devices, and of the roles that choose among them."""
    several = {port: given for port in PORTS if (given := getattr(config, port)) is not None and given.type is None}
    chosen = [port for port, mark in PORTS.items() if mark.chosen]
    for port, section in several.items():
        yield from _wrong_table(port, section)
        if port in chosen and port not in config.roles:
            yield f"roles.{port}", f"is missing: there are {join_words(section.tables)}; name the one that the job uses"
    for port, name in config.roles.items():
        if port not in chosen:
            yield (
                f"roles.{port}",
                f"unknown key{did_you_mean(port, chosen)} Known here: {join_words(chosen)}. Correct or remove it",
            )
        elif port not in several:
            yield f"roles.{port}", f"there is one {port}, without a name; remove the line, or name it: [{port}.{name}]"
        elif name not in several[port].tables:
            known = several[port].tables
            yield (
                f"roles.{port}",
                f"there is no {name!r}{did_you_mean(name, known)} There are: {join_words(known)}. Name one of them",
            )


def _wrong_signals(config: CellConfig) -> Iterator[tuple[str, str]]:
    """Yield (key, problem) of signals: each needs one of the monitors."""
    named = {} if config.monitor is None else config.monitor.tables
    for name, signal in config.signals.items():
        key = f"signals.{name}"
        if config.monitor is None:
            yield key, "no monitor reads it: the cell has no [monitor]; add one, or remove the section"
        elif signal.monitor is None and named:
            yield f"{key}.monitor", f"is missing: there are {join_words(named)}; name the one that reads it"
        elif signal.monitor is not None and not named:
            todo = f"remove the line, or name it: [monitor.{signal.monitor}]"
            yield f"{key}.monitor", f"there is one monitor, without a name; {todo}"
        elif signal.monitor is not None and signal.monitor not in named:
            known = f"{did_you_mean(signal.monitor, named)} There are: {join_words(named)}. Name one of them"
            yield f"{key}.monitor", f"there is no {signal.monitor!r}{known}"


def _wrong_table(port: str, section: DeviceSection) -> Iterator[tuple[str, str]]:
    for name in {**dict.fromkeys(section.model_fields_set - {"type"}), **(section.model_extra or {})}:
        keys = section.tables.get(name, {})
        if name not in section.tables:
            yield f"{port}.{name}", f"is not a device; move it into one of {join_words(section.tables)}"
        elif not re.fullmatch(r"[\w-]+", name, re.ASCII):
            yield f"{port}.{name}", "is not a valid name; use letters, digits, '-' and '_'"
        elif not isinstance(keys.get("type"), str):
            yield f"{port}.{name}.type", "is missing; add it: type = ..."


def device_options(config: CellConfig, device: str, device_types: Mapping[str, DeviceType]) -> tuple[DeviceType, Any]:
    """Return the device type named in a device's section, and the section's other keys as its options model."""
    raw, port, named = config.devices[device], port_of(device), str(config.devices[device].type)
    fitting = {name for name, kind in device_types.items() if kind.port == port}
    kind = device_types.get(named)
    if kind is None:
        raise config.error(
            f"{device}.type",
            f"unknown type {named!r}{did_you_mean(named, fitting)} The loaded plugins have: {join_words(fitting)}; "
            "plugins.load must name its plugin, for polishd's own 'devices'",
        )
    if kind.port != port:
        raise config.error(f"{device}.type", f"{named!r} is a {kind.port} type; use one of {join_words(fitting)}")
    given, of_port = dict(raw.model_extra or {}), set(type(raw).model_fields) - {"type"}
    return kind, _judged(config, tuple(device.split(".")), kind.options, given, of_port)


def notifier_options(config: CellConfig, name: str, types: Mapping[str, NotifierType]) -> tuple[NotifierType, Any]:
    """Return the notifier type named in ``[notify.NAME]``, and its keys as the type's options model."""
    section = config.notify[name]
    kind = types.get(section.type)
    if kind is None:
        raise config.error(
            f"notify.{name}.type",
            f"unknown type {section.type!r}{did_you_mean(section.type, types)} The loaded plugins have: "
            f"{join_words(types)}; plugins.load must name its plugin, for polishd's own 'notifications'",
        )
    return kind, _judged(config, ("notify", name), kind.options, dict(section.model_extra or {}))


def _judged(
    config: CellConfig,
    section: Location,
    options: type[BaseModel],
    given: Mapping[str, Any],
    also: Collection[str] = (),
) -> Any:
    """Return a plugin's options; raise ConfigError with a line for each fault. Keys in ``also`` are allowed too."""
    known = {field.alias or name for name, field in options.model_fields.items()} | set(also)
    # found here, because a plugin's model may ignore them
    unknown = [] if options.model_config.get("extra") == "allow" else [key for key in given if key not in known]
    found = [config.source.error((*section, key), _unknown_message((*section, key), known)) for key in unknown]
    try:
        value = options.model_validate({key: one for key, one in given.items() if key not in unknown})
    except ValidationError as error:
        found += validation_problems(error, options, config.source, section)
    else:
        if not found:
            return value
    raise ConfigError("\n".join(found))


def _unknown_message(location: Location, known: Collection[str]) -> str:
    if new := renamed_key(".".join(map(str, location))):
        return f"was renamed: write {new}"
    return f"unknown key{did_you_mean(str(location[-1]), known)} Known here: {join_words(known)}. Correct or remove it"


def _included(raw: Mapping[str, Any], source: TomlSource) -> list[str]:
    names = raw.get("include", [])
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise ConfigError(source.error(("include",), 'must be a list of file names, such as ["calibration.toml"]'))
    return names


def overlay(raw: dict[str, Any], fragment: Mapping[str, Any]) -> None:
    """Replace keys of the file's tables by those of the fragment."""
    for name, value in fragment.items():
        if isinstance(value, dict) and isinstance(raw.get(name), dict):
            overlay(raw[name], value)
        else:
            raw[name] = value


def _override(raw: dict[str, Any], key: str, value: Any, source: TomlSource) -> None:
    *tables, last = key.split(".")
    inner = raw
    for name in tables:
        inner = inner.setdefault(name, {})
        if not isinstance(inner, dict):
            raise ConfigError(source.error(tuple(key.split(".")), f"{name!r} is not a section; correct the override"))
    inner[last] = value
