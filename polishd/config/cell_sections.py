"""Sections of a cell's configuration: one frozen model each, with ranges in the types."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, field_validator, model_validator

from polishd.config.fields import (
    Angle,
    Angles,
    ConfigSection,
    FileNames,
    Name,
    NotNegative,
    OpticKeys,
    Pair,
    Positive,
    Range,
    Seconds,
    Share,
    ShareOrNone,
    Text,
    Texts,
    Vector,
    as_tuple,
)
from polishd.model.devices import SignalAction, SignalLimits, SignalRange
from polishd.model.dwell import Choice
from polishd.model.estimates import FindingLimits
from polishd.model.outline import Outline
from polishd.model.tolerance import Accept
from polishd.process.removal.ripple import LAG_MM, LINE_ERROR_MM, RADIUS_ERROR, PathErrors

_FINDING = FindingLimits()

MOST_FEED_MM_S = 1000.0
MOST_ACCEL_MM_S2 = 20_000.0
"""Two g. A larger feed or acceleration is a mistake: the planned times would be shorter than any machine's."""


def _feed(value: float) -> float:
    if value > MOST_FEED_MM_S:
        raise ValueError(
            f"{value:g} mm/s is faster than any polishing robot; must be at most {MOST_FEED_MM_S:g} mm/s: "
            f"if the data sheet says {value:g} mm/min, write {value / 60:.6g}"
        )
    return value


@dataclass(frozen=True, slots=True)
class DeviceInterface:
    """Mark a section of the cell as a port, with the requirements on its devices."""

    protocol: type
    acts: bool = True
    """The devices press, move or turn, and are made safe. False: they only measure."""
    of_part: bool = False
    """The devices are built anew for each job's part."""
    chosen: bool = True
    """A job uses one of the devices. False: it uses all of them."""


class DeviceSection(ConfigSection):
    """A device: its type, and the raw options that the type's model validates (see ``device_options``).

    Or a table of several devices with names: ``[robot.left]`` and ``[robot.right]`` are then such sections.
    """

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)
    type: Text | None = None
    """A device type of a loaded plugin. The type defines the other keys."""

    @model_validator(mode="after")
    def _one_or_several(self) -> Self:
        if self.type is None and not self.tables:
            raise ValueError("type: is missing; add it: type = ...")
        return self

    @property
    def tables(self) -> dict[str, dict[str, Any]]:
        """Keys of each device of a table of several, as written."""
        return {} if self.type else {k: v for k, v in (self.model_extra or {}).items() if isinstance(v, dict)}

    def devices(self, port: str) -> dict[str, DeviceSection]:
        """Return the section of each device by its dotted name."""
        if self.type is not None:
            return {port: self}
        return {f"{port}.{name}": type(self).model_validate(keys) for name, keys in self.tables.items()}


class RobotSection(DeviceSection):
    """The robot that carries the tool along its program.

    `type` defines the other keys.
    """

    least_override: Annotated[float, Field(ge=0, le=1)] = 0.95
    """Least speed override at the controller, if it can be read. Below it the daemon refuses or leaves contact, because
    slower motion removes more than planned. [1]"""
    no_progress_s: Annotated[float, Field(gt=0, le=10)] | None = None
    """Time without progress beyond a block's expected time. The daemon then takes the robot as stopped and leaves
    contact. Left out: the age of the robot's reports plus 0.2 s. `polishd check` prints how much a tool that does not
    move removes in this time."""


class ForceSensorSection(DeviceSection):
    """A force sensor independent of the actuator: both must report the same force (docs/how-to/monitors.md).

    `type` defines the other keys.
    """

    max_difference_n: Positive = 1.0
    """Largest difference between its reading and the actuator's. A larger one for `alarm_delay_s` is a safety stop."""
    alarm_delay_s: Annotated[float, Field(ge=0, le=10)] = 0.5
    """Time for which the difference may be larger: filters differ, and the force rises steeply at landing."""


class NotifySection(ConfigSection):
    """A way to notify people, with a name: `[notify.mail]`. `type` defines the other keys."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, allow_inf_nan=False)
    type: Text
    """A notifier type of a loaded plugin: polishd's `notifications` has `email`, `webhook` and `command`."""
    severity: Literal["info", "warning", "alarm"] = "warning"
    """Lowest severity that is sent: `warning` needs an operator, `alarm` needs one at once."""
    remind_after_s: Annotated[float, Field(ge=0, le=86400)] = 1800.0
    """Time in which repeats of a notification are counted and sent as one at its end. 0: each one is sent."""


class CellSection(ConfigSection):
    """The cell's name, and the folder of its state."""

    name: Name
    """The cell's name, in the log, the journal and the report."""
    state_dir: Text
    """Folder of the journal, the lock, the socket and the log; one daemon per folder."""
    run_dir: Text | None = None
    """The run folder. Left out: `state_dir/runs/<job>-<time>`."""


class PluginsSection(ConfigSection):
    """The plugins to load, by entry-point name."""

    load: Annotated[Texts, Field(min_length=1)]
    """The plugins to load, by entry-point name. Device types, formats, models and solvers of other plugins are
    unknown."""

    @field_validator("load")
    @classmethod
    def _once(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"named twice: {', '.join(map(repr, twice))}; name each plugin once")
        return names


class InstrumentSection(ConfigSection):
    """The instrument whose maps the cell polishes by."""

    profile: Text | None = None
    """File of the instrument's profile. `polishd run` refuses a cell without one."""
    spike_threshold_mad: NotNegative = 0.0
    """Distance from the surrounding surface at which a sample is removed as a spike, in scaled median absolute
    deviations. A steep bump is removed, too. 0: no spikes are searched. [MAD]"""


class PartSection(OpticKeys):
    """The part, and its pose in the robot's base frame."""

    id: Text
    """The part's name. Each map must name the same part."""
    polygon_file: Text | None = None
    """Instead of `aperture_mm`: CSV file of the corners, columns `x_mm` and `y_mm`, in order around the part."""
    edge_mm: NotNegative = 3.0
    """Width of the rim outside the clear aperture. Figures and tolerance do not count it."""
    free_edge: bool = False
    """True: the part's edge is free, and the bonnet sinks over it. False: the part sits in a flush ring."""
    alignment: Literal["piston", "tilt", "power"] = "tilt"
    """Terms of a map that are alignment, not figure: piston; piston and tilt; piston, tilt and power."""
    form: Text | None = None
    """A map of the desired form in the part's frame, for a test without a null that makes this form appear flat."""
    origin_mm: Vector
    """The part's center in the robot's base frame."""
    rotation_rpy_deg: Angles
    """Rotation of its frame there: intrinsic rotations about x, y' and z''. z is the surface's normal."""

    @model_validator(mode="after")
    def _has_clear_aperture(self) -> Self:
        if self.polygon_file is None:
            for key, problem in self.misfits(self.outline):
                raise ValueError(f"{key}: {problem}")
        return self

    def misfits(self, outline: Outline) -> Iterator[tuple[str, str]]:
        """Yield (key, problem) of values that contradict the part's outline."""
        depth, radius = outline.depth_mm, self.curvature_radius_mm
        if depth <= 0:
            yield self.outline_key, "the part's center, x 0 and y 0, lies outside; give corners around it"
        elif self.edge_mm >= depth:
            yield (
                "edge_mm",
                f"no clear aperture is left: the part's center is {depth:g} mm from its rim; must be less",
            )
        if radius is not None and (1 + self.conic) * outline.radius_mm**2 >= radius**2:
            across = 2 * outline.radius_mm
            yield "curvature_radius_mm", f"{radius:g} mm is too small for an aperture of {across:g} mm"


class ProgramSection(ConfigSection):
    """The part program, and the pose of its frame on the part: ``part = rotation_z @ program + offset``."""

    path: FileNames
    """The part program, or a list of programs that take turns from pass to pass (docs/how-to/paths.md)."""
    format: Text = "rs274"
    """Its dialect, as `polishd program dialects` lists them."""
    dialects: Texts = ()
    """Your own dialect profiles (TOML), which `format` may then name."""
    coverage: Literal["aperture", "zone"] = "aperture"
    """`aperture`: the program must reach the whole clear aperture. `zone`: it deliberately leaves out a part of it."""
    offset_mm: Vector = (0.0, 0.0, 0.0)
    """Position of the program's origin on the part: `part = rotation_z(rotation_deg) @ program + offset`."""
    rotation_deg: Angle = 0.0
    """Rotation of the program's frame on the part, counter-clockwise."""

    @property
    def paths(self) -> tuple[str, ...]:
        """The programs in the order in which they take turns; one where `path` names one."""
        return (self.path,) if isinstance(self.path, str) else self.path


class MachineSection(ConfigSection):
    """Limits of the machine from its data sheet, on the safe side."""

    max_feed_mm_s: Annotated[
        float, Field(gt=0, json_schema_extra={"range": f"<= {MOST_FEED_MM_S:g}"}), AfterValidator(_feed)
    ]
    """Highest feed of a plan, the lower bound of each block's time. Data sheets often use mm/min."""
    min_feed_mm_s: Positive
    """Lowest feed of a plan, the upper bound of each block's time."""
    accel_mm_s2: Annotated[float, Field(gt=0, le=MOST_ACCEL_MM_S2)]
    """Acceleration used for planned times, on the safe side; at most two g."""
    block_overhead_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Start value of the time that a block takes beyond its motion. The daemon estimates it from executed passes."""
    least_point_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Least time of a timed point in a plan. A robot that holds few instructions needs it (`polishd check`)."""
    corner_deg: Annotated[float, Field(ge=0, le=180)] = 30.0
    """Change of direction beyond which the machine stops at a block's end."""
    x_mm: Range
    """Range of the tool's tip along the program's x. A plan beyond it is refused."""
    y_mm: Range
    """Range of the tool's tip along y."""
    z_mm: Range
    """Range of the tool's tip along z."""

    @model_validator(mode="after")
    def _feeds_ordered(self) -> Self:
        if self.min_feed_mm_s >= self.max_feed_mm_s:
            raise ValueError("min_feed_mm_s: must be less than max_feed_mm_s; exchange or correct them")
        return self


class DwellSection(ConfigSection):
    """Solver of the dwell, and its check."""

    solver: Text = "auto"
    """Name of the solver: `auto`, the fastest of polishd's solvers, or the name of a plugin's solver."""
    cross_check: str = "qp"
    """An independent solver for the same problem; `""` for none."""
    cross_check_above: NotNegative = 1e-4
    """The cross-check runs if the certificate cannot prove that less than this share of the objective could be gained
    (`gap`). 0: it always runs. [1]"""
    regularisation: NotNegative = 1e-4
    """Weight of the squared dwell, as rho = regularisation N_r / sigma_max^2: more conditions better and follows less.
    [1]"""
    feed_change: NotNegative = 0.0
    """Weight of the change of feed between neighboring blocks in the objective, for programs whose times are feeds. 1:
    it counts as much as the removal that the machine's acceleration loses without it. 0: it does not count. [1]"""
    extension: Literal["none", "nearest", "c1", "gerchberg_papoulis"] = "c1"
    """Continuation of the surface beyond the part's rim, where the map has no data."""
    cpu_limit_s: Seconds = 120.0
    """CPU seconds for the whole solve step of a cycle: removal model, iterations, objective, cross-check and curve. The
    wall time may be 10 times as long, plus 60 s."""
    kkt_tolerance: Share = 1e-4
    """Largest KKT residual of a dwell. A dwell with a larger one is not used. [1]"""
    objective: Choice = "least"
    """Selection of the dwell: the least residual, or a point on the curve of residual against time: where 1 % more time
    improves it by less than 1 %, at `target_nm`, or within `budget_s`. `as_programmed` keeps the program's times for
    any map, for one pass that estimates the removal and does not correct."""
    budget_s: Positive | None = None
    """Total dwell for `objective = "budget"`, which takes the best residual within it."""
    target_nm: Positive | None = None
    """RMS to reach for `objective = "target"`, in the least time."""
    curve: bool = False
    """Add the curve of residual against time to each plan. It takes about 15 solves."""

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        for rule, key in (("budget", "budget_s"), ("target", "target_nm")):
            if (self.objective == rule) != (getattr(self, key) is not None):
                raise ValueError(f'{key}: set it together with objective = "{rule}", or leave out both')
        if self.cross_check == self.solver:
            raise ValueError('cross_check: must be another solver than dwell.solver, or "" for none')
        return self


class RippleSection(ConfigSection):
    """Errors that the forecast of ripple counts with (docs/explanation/ripple.md).

    95 % of spots, lines and passes are within them.
    """

    radius_error: Annotated[float, Field(ge=0, lt=0.5)] = RADIUS_ERROR
    """Of the spot's radius, relative: of a measured TIF, of wear, of the pressure. [1]"""
    line_error_mm: Annotated[float, Field(ge=0, le=10)] = LINE_ERROR_MM
    """Of each line's place across it, independent of the other lines': the robot's path accuracy without what all lines
    have in common."""
    lag_mm: Annotated[float, Field(ge=0, le=10)] = LAG_MM
    """Distance along the path that the tool trails the programmed point by, because of friction and backlash. A delay
    in time alone is none."""

    @property
    def errors(self) -> PathErrors:
        """The errors as the forecast takes them."""
        return PathErrors(self.radius_error, self.line_error_mm, self.lag_mm)


class JobSection(ConfigSection):
    """The goal of a job, and its limits."""

    id: Name
    """The job's name. It is in the run folder's name, and a restarted daemon continues the job of this name."""
    tolerance_nm: Positive | None = None
    """RMS in the clear aperture at which the part is accepted: the short form of a `[[tolerance]]` with `rms_nm`."""
    tolerance_period_mm: NotNegative = 0.0
    """Period above which `tolerance_nm` counts; 0: all periods."""
    accept_by: Accept | None = None
    """Value by which an RMS is accepted: the measured one (`figure`), the one-sided 95 % bound of the part's RMS
    (`bound`), or that bound without power (`bound_without_power`), which the certificate then states. Left out:
    `bound` if the instrument's profile has a system map, else `figure`."""
    lsf_period_mm: Positive = 33.0
    """Period above which the low-frequency figure (`lsf_rms_nm`) counts."""
    max_cycles: Annotated[int, Field(ge=1, le=100)] = 4
    """Largest number of passes. A measurement follows the last one, too. [1]"""
    approve: bool = False
    """Each plan waits for `polishd approve` before its pass. Nothing moves until then."""
    stream_ahead_s: Annotated[float, Field(ge=0.2, le=600)] = 8.0
    """Wall seconds of motion that are sent ahead. They must suffice to lift the tool while the robot still moves."""


class MemorySection(ConfigSection):
    """Estimates that a job takes over from earlier jobs (docs/explanation/estimates.md)."""

    use_previous: bool = True
    """Start a job with the estimates of the last pass with the same tool, process, robot and instrument."""
    tool: Text | None = None
    """Name of the tool on the spindle. A new name starts new estimates."""


class CertificateSection(ConfigSection):
    """Issuer of the certificates of this cell's parts (docs/how-to/certificate.md)."""

    shop: str = ""
    """The shop's name on a certificate."""
    key: Text | None = None
    """File of the shop's private key, made by `polishd certificate keygen`, which signs certificates. Left out:
    certificates are not signed."""


class LimitsSection(ConfigSection):
    """Limits that protect the part."""

    force_band: Share = 0.25
    """Largest relative deviation of the force from its set point. A larger one for `force_alarm_delay_s` is a safety
    stop. [1]"""
    force_alarm_delay_s: Annotated[float, Field(ge=0, le=10)] = 0.3
    """Time for which the force may be outside `force_band`."""
    max_removal_nm: Positive = 1000.0
    """Largest removal of one pass at any point. A plan beyond it is refused."""
    excess_nm: Positive | None = None
    """Largest removal beyond the plan at any point because the robot is slower than planned. The daemon leaves contact
    before. Left out: the larger of half of the tolerance and a tenth of the planned removal at that point."""
    max_stall_removal_nm: Positive = 10.0
    """Deepest pit that an operator's feed hold may make before the force is off, if the robot's controller shows the
    hold in its reports only. A cell whose robot could make a deeper one is refused."""
    max_pass_s: Positive = 86400.0
    """Longest process time of one pass. The default is a day: a pass over a meter takes 17 h, and a pass with a removal
    rate that is wrong by a unit's factor of 100 takes days."""
    max_rate_change: Share = 0.4
    """Largest relative distance of an estimated removal rate from 1. Beyond it the limit is used, and the cell is held
    if two standard errors do not explain the difference. [1]"""
    max_rate_drift: Share = _FINDING.max_rate_drift
    """Largest relative change of the removal rate during one pass, or since the first passes of this process. The cell
    is held if a change is significantly larger. [1]"""
    max_spot_change: Share = _FINDING.max_spot_change
    """Largest relative difference between the spot's width and the model's. The cell is held if a difference is
    significantly larger. [1]"""
    min_improvement: ShareOrNone = _FINDING.min_improvement
    """Least share of the predicted RMS improvement that a pass must reach. Two passes in a row below it end the job as
    stalled. The daemon makes no pass that gains less than the ripple that it adds, or that will probably not improve
    the surface. 0: no pass does either. [1]"""

    @property
    def finding(self) -> FindingLimits:
        """Limits beyond which a pass reports a finding."""
        return FindingLimits(self.max_rate_drift, self.max_spot_change, self.min_improvement)


# Touch-off, and steps between passes.


class TouchOffSection(ConfigSection):
    """Check of the part's height and seat before contact. Left out: they are not checked."""

    force_n: Annotated[float, Field(gt=0, le=0.8)] = 0.8
    """Force with which the tool rests on each point, with the spindle stopped. A quarter more is accepted, at most
    1 N."""
    force_max_n: Annotated[float, Field(gt=1, le=10)] = 2.0
    """Largest force that any device may read in a touch-off. One reading above it, or a rise that would exceed it
    before the next reading, makes the daemon leave contact at once."""
    position_mm: Positive | None = None
    """Position of the actuator in contact with that force when the tool's tip is at the programmed point. Left out:
    half of `actuator.stroke_mm`."""
    max_offset_mm: Positive = 0.3
    """Largest distance of any point of the part from its position by `[part]`. The tool goes no deeper than that."""
    points_mm: Annotated[tuple[Pair, Pair, Pair] | None, BeforeValidator(as_tuple)] = None
    """Three points (x, y) on the part or its ring, outside the clear aperture. Left out: points in the middle of the
    rim of `part.edge_mm`."""
    each_pass: bool = False
    """Check the seat before each pass, for a part that leaves its seat to be measured. False: before the first pass
    after a start, a hold or an interruption."""


class StepSection(ConfigSection):
    """A step done by the operator or by a command, with the tool up and the robot at rest."""

    operator: Text | None = None
    """Instruction to the operator. The cell is held until `polishd resume`."""
    command: Texts = ()
    """Program and arguments, run in the folder of the cell's file. Exit code 0 means done."""
    timeout_s: Seconds = 600.0
    """Time limit of the command, which is killed after it."""

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.operator is None) == (not self.command):
            raise ValueError('operator: set one of operator = "wipe the part" and command = ["./wash.sh"]')
        return self


class SettleSection(ConfigSection):
    """Repeat the measurement until two maps in a row agree within the instrument's noise. The last one counts."""

    wait_s: Annotated[float, Field(ge=0, le=86400)] = 60.0
    """Time between two maps."""
    max_maps: Annotated[int, Field(ge=2, le=1000)] = 10
    """Largest number of maps of one measurement. The cell is held if no two in a row agree. [1]"""


class BetweenSection(ConfigSection):
    """Steps between passes. Each table that is present is done."""

    clean: StepSection | None = None
    """Clean the part before each measurement."""
    settle: SettleSection | None = None
    """Wait for thermal equilibrium in each measurement, also the first."""
    condition: StepSection | None = None
    """Condition the pad before the next pass."""
    change: StepSection | None = None
    """Change the tool, if there are [tools]. `POLISHD_TOOL` has its name. Left out: the operator mounts it."""


# ``[signals.NAME]``: required values of a signal before contact and in it, and the action if it is out of range.


class BoundsSection(ConfigSection):
    """Required value of a signal: a state, or a range."""

    min: float | None = None
    """Smallest allowed value. [in `unit`]"""
    max: float | None = None
    """Largest allowed value. [in `unit`]"""
    state: bool | None = None
    """Required state of a signal that is on or off."""

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if self.state is None and self.min is None and self.max is None:
            raise ValueError("has no limit; write min, max, or state")
        if self.state is not None and (self.min, self.max) != (None, None):
            raise ValueError("state: cannot be combined with min and max; a signal is a state or a number")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError("min: must be at most max")
        return self

    @property
    def bounds(self) -> SignalRange:
        """The required range as the daemon checks it."""
        return SignalRange(self.min, self.max, self.state)


class BeforeSection(BoundsSection):
    """Required value before contact. The cell waits for it, and is held after `wait_s`."""

    wait_s: Annotated[float, Field(ge=0, le=3600)] = 30.0
    """Longest wait for the value."""


class InContactSection(BoundsSection):
    """Required value in contact."""

    alarm_delay_s: Annotated[float, Field(ge=0, le=600)] = 0.5
    """Time for which the value may be out of range or unknown."""


class SignalSection(ConfigSection):
    """A monitored signal of the cell: slurry flow, a pressure, a guard (docs/how-to/monitors.md)."""

    monitor: Name | None = None
    """The monitor that reads it, if there are several: `plc` of `[monitor.plc]`."""
    signal: Text | None = None
    """Its name at the monitor. Left out: the name of this section."""
    unit: str = ""
    """Unit of its values, for messages."""
    measures: Literal["force"] | None = None
    """It measures the force on the part, in N. One value above `process.force_max_n` (in a touch-off
    `touch_off.force_max_n`) makes the daemon leave contact at once, independent of the other keys."""
    before: BeforeSection | None = None
    in_contact: InContactSection | None = None
    on_start: BoundsSection | None = None
    """Required value when the operator orders motion, from any terminal: a key switch at the cell, for example. With
    another value `resume` and `approve` are refused."""
    action: SignalAction = "hold"
    """Action in contact: send a notification and continue; leave contact and hold the cell; leave contact and end the
    daemon with a safety stop; or stop motion at once, even if that damages the part."""

    @model_validator(mode="after")
    def _is_watched(self) -> Self:
        if self.measures == "force" and self.unit not in {"", "N"}:
            raise ValueError(f'unit: is {self.unit!r}; a signal that measures the force has "N"')
        if (self.before, self.in_contact, self.on_start, self.measures) == (None, None, None, None):
            raise ValueError("has no requirement; write before = {...}, in_contact = {...}, or both")
        if self.in_contact is None and "action" in self.model_fields_set:
            raise ValueError("action: needs in_contact; a wrong value before contact holds the cell")
        return self

    def limits(self, name: str) -> SignalLimits:
        """Return the limits that the daemon monitors."""
        before, in_contact = self.before, self.in_contact
        return SignalLimits(
            name=name,
            monitor="monitor" if self.monitor is None else f"monitor.{self.monitor}",
            signal=self.signal or name,
            unit=self.unit,
            before=before.bounds if before else None,
            wait_s=before.wait_s if before else 0.0,
            in_contact=in_contact.bounds if in_contact else None,
            alarm_delay_s=in_contact.alarm_delay_s if in_contact else 0.0,
            action=self.action,
            on_start=self.on_start.bounds if self.on_start else None,
            measures_force=self.measures == "force",
        )
