"""The sections of a cell's configuration: one frozen model each, with its ranges in the types."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, field_validator, model_validator

from polishd.config.fields import (
    Angle,
    Angles,
    ConfigSection,
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

_FINDING = FindingLimits()

MOST_FEED_MM_S = 1000.0
MOST_ACCEL_MM_S2 = 20_000.0
"""Two g: beyond both a number is a mistake, and times are planned that no machine keeps."""


def _feed(value: float) -> float:
    if value > MOST_FEED_MM_S:
        raise ValueError(
            f"{value:g} mm/s is faster than any polishing robot; must be at most {MOST_FEED_MM_S:g} mm/s: "
            f"if the data sheet says {value:g} mm/min, write {value / 60:.6g}"
        )
    return value


@dataclass(frozen=True, slots=True)
class DeviceInterface:
    """Marks a section of the cell as one for devices, and says what is asked of them."""

    protocol: type
    acts: bool = True
    """They press, move or turn: they are made safe. Else they only look."""
    of_part: bool = False
    """They are built for one part: anew for each job."""
    chosen: bool = True
    """A job uses one of them; else all that there are."""


class DeviceSection(ConfigSection):
    """A device: its type, and the raw options that the type's own model judges (see ``device_options``).

    Or a table of several, by names of the user's: ``[robot.left]`` and ``[robot.right]`` are such sections each.
    """

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)
    type: Text | None = None
    """A device type that a loaded plugin has; its plugin says which other keys there are."""

    @model_validator(mode="after")
    def _one_or_several(self) -> Self:
        if self.type is None and not self.tables:
            raise ValueError("type: is missing; add it: type = ...")
        return self

    @property
    def tables(self) -> dict[str, dict[str, Any]]:
        """Of a table of several: each one's keys, as they stand in the file."""
        return {} if self.type else {k: v for k, v in (self.model_extra or {}).items() if isinstance(v, dict)}

    def devices(self, port: str) -> dict[str, DeviceSection]:
        """By name: its dotted section."""
        if self.type is not None:
            return {port: self}
        return {f"{port}.{name}": type(self).model_validate(keys) for name, keys in self.tables.items()}


class RobotSection(DeviceSection):
    """The robot that carries the tool along its program.

    `type` says which other keys there are.
    """

    least_override: Annotated[float, Field(ge=0, le=1)] = 0.95
    """Least speed override at the controller, where it can be read: below it contact is refused, or left, for slower
    motion removes more than planned. [1]"""
    no_progress_s: Annotated[float, Field(gt=0, le=10)] | None = None
    """Time beyond a block's expected time without any progress, after which the robot counts as standing and contact is
    left. Left out: the age of its reports and 0.2 s. `polishd check` prints what a standing tool removes in it."""


class ForceSensorSection(DeviceSection):
    """A force sensor that is independent of the actuator: both must tell the same force (docs/monitors.md).

    `type` says which other keys there are.
    """

    max_difference_n: Positive = 1.0
    """How far its word and the actuator's may be apart; farther for `alarm_delay_s` is a safety stop."""
    alarm_delay_s: Annotated[float, Field(ge=0, le=10)] = 0.5
    """How long they may be apart: filters differ, and a landing is steep."""


class NotifySection(ConfigSection):
    """A way to reach a person: `[notify.mail]`, by names of the user's. `type` says which other keys there are."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, allow_inf_nan=False)
    type: Text
    """A notifier type that a loaded plugin has: `email`, `webhook` and `command` of polishd's `notifications`."""
    severity: Literal["info", "warning", "alarm"] = "warning"
    """The least that is told: `warning` is all for which the cell needs a person, `alarm` what cannot wait."""
    remind_after_s: Annotated[float, Field(ge=0, le=86400)] = 1800.0
    """What happens again within that time is counted, and told once at its end; 0: each time."""


class CellSection(ConfigSection):
    """Who this cell is, and where it keeps its state."""

    name: Name
    """The cell's name, in the log, the journal and the report."""
    state_dir: Text
    """Folder of the journal, the lock, the socket and the log; one daemon per folder."""
    run_dir: Text | None = None
    """Where the run folder goes; left out: `state_dir/runs/<job>-<time>`."""


class PluginsSection(ConfigSection):
    """The plugins to load, by entry-point name."""

    load: Annotated[Texts, Field(min_length=1)]
    """The plugins to load, by entry-point name; nothing else is. A device type, format, model or solver of another
    plugin is unknown."""

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
    """File of the profile of the instrument whose maps the cell polishes by; without one `run` refuses."""
    spike_threshold_mad: NotNegative = 0.0
    """How far off the surface about it a sample is a spike and has no data, in scaled median absolute deviations; so
    has a steep bump. 0: none is looked for. [MAD]"""


class PartSection(OpticKeys):
    """The part, and where it lies in the robot's base frame."""

    id: Text
    """The part's name, which each map must give."""
    polygon_file: Text | None = None
    """Instead of `aperture_mm`: CSV file of the corners, columns `x_mm` and `y_mm`, in order around the part."""
    edge_mm: NotNegative = 3.0
    """Width of the rim that the clear aperture leaves out: figures and tolerance do not count it."""
    free_edge: bool = False
    """Whether the part's edge is free, so that the bonnet sinks over it; else the part sits in a flush ring."""
    alignment: Literal["piston", "tilt", "power"] = "tilt"
    """What of a map is alignment and no figure: piston; piston and tilt; piston, tilt and power."""
    form: Text | None = None
    """A map of the form wanted, in the part's frame, where no null makes that flat in the interferometer's eyes."""
    origin_mm: Vector
    """The part's centre in the robot's base frame."""
    rotation_rpy_deg: Angles
    """How its frame lies there: intrinsic turns about x, y' and z''; z is the surface's normal."""

    @model_validator(mode="after")
    def _has_clear_aperture(self) -> Self:
        if self.polygon_file is None:
            for key, problem in self.misfits(self.outline):
                raise ValueError(f"{key}: {problem}")
        return self

    def misfits(self, outline: Outline) -> Iterator[tuple[str, str]]:
        """(key, what is wrong) of what does not go with the part's outline."""
        depth, radius = outline.depth_mm, self.curvature_radius_mm
        if depth <= 0:
            yield self.outline_key, "the part's centre, x 0 and y 0, lies outside; give corners about it"
        elif self.edge_mm >= depth:
            yield (
                "edge_mm",
                f"no clear aperture is left: the part's middle lies {depth:g} mm from its rim; must be less",
            )
        if radius is not None and (1 + self.conic) * outline.radius_mm**2 >= radius**2:
            across = 2 * outline.radius_mm
            yield "curvature_radius_mm", f"{radius:g} mm is no surface of {across:g} mm aperture"


class ProgramSection(ConfigSection):
    """The part program, and how its frame lies on the part: ``part = rotation_z @ program + offset``."""

    path: Text
    """The part program."""
    format: Text = "rs274"
    """Its dialect, as `polishd program dialects` lists them."""
    dialects: Texts = ()
    """Profiles of your own (TOML), which `format` may then name."""
    coverage: Literal["aperture", "zone"] = "aperture"
    """Whether it reaches the whole clear aperture, or leaves a part of it alone on purpose."""
    offset_mm: Vector = (0.0, 0.0, 0.0)
    """Where the program's origin lies on the part: `part = rotation_z(rotation_deg) @ program + offset`."""
    rotation_deg: Angle = 0.0
    """How the program's frame is turned on the part, counter-clockwise."""


class MachineSection(ConfigSection):
    """What the machine can do, from its data sheet, on the safe side."""

    max_feed_mm_s: Annotated[
        float, Field(gt=0, json_schema_extra={"range": f"<= {MOST_FEED_MM_S:g}"}), AfterValidator(_feed)
    ]
    """Fastest feed of a plan: it bounds each block's time from below. Data sheets often say mm/min."""
    min_feed_mm_s: Positive
    """Slowest feed of a plan: it bounds each block's time from above."""
    accel_mm_s2: Annotated[float, Field(gt=0, le=MOST_ACCEL_MM_S2)]
    """Acceleration that planned times count with, on the safe side; at most two g."""
    block_overhead_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Time that a block takes beyond its motion, at first; learned from what was executed."""
    corner_deg: Annotated[float, Field(ge=0, le=180)] = 30.0
    """Change of direction beyond which the machine stops at a block's end."""
    x_mm: Range
    """Range of the tool's tip along the program's x; a plan beyond it is refused."""
    y_mm: Range
    """The same along y."""
    z_mm: Range
    """The same along z."""

    @model_validator(mode="after")
    def _feeds_ordered(self) -> Self:
        if self.min_feed_mm_s >= self.max_feed_mm_s:
            raise ValueError("min_feed_mm_s: must be less than max_feed_mm_s; exchange or mend them")
        return self


class DwellSection(ConfigSection):
    """How the dwell is solved, and by whom it is checked."""

    solver: Text = "auto"
    """Who solves: `auto`, the fastest of polishd's own, or the name that a plugin gives it."""
    cross_check: str = "qp"
    """An independent solver that is asked about the same problem; `""` for none."""
    cross_check_above: NotNegative = 1e-4
    """It is asked where the certificate cannot prove by itself that less than this share of the objective could be
    gained (`gap`); 0: always. [1]"""
    regularisation: NotNegative = 1e-4
    """Weight of the squared dwell, as rho = regularisation N_r / sigma_max^2: more conditions better and follows less.
    [1]"""
    extension: Literal["none", "nearest", "c1", "gerchberg_papoulis"] = "c1"
    """How the surface goes on beyond the part's rim, where the map has no data."""
    cpu_limit_s: Seconds = 120.0
    """CPU seconds for the whole solve step of a cycle: removal model, rounds, choice, cross-check and curve. On the
    wall, 10 times as many and 60 s."""
    kkt_tolerance: Share = 1e-4
    """Largest KKT residual of a dwell that is used; one beyond it gives no plan. [1]"""
    objective: Choice = "least"
    """Which dwell: the least residual, or a point of the curve of residual against time, where 1 % more time buys
    less than 1 %, at `target_nm`, or within `budget_s`. Or `as_programmed`: the times that the program has, whatever
    the map says, for one pass that is to teach, not to correct."""
    budget_s: Positive | None = None
    """Total dwell for `objective = "budget"`: the best residual in it."""
    target_nm: Positive | None = None
    """RMS to reach for `objective = "target"`, in the least time."""
    curve: bool = False
    """Whether each plan comes with its curve of residual against time, which takes some 15 solves."""

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        for rule, key in (("budget", "budget_s"), ("target", "target_nm")):
            if (self.objective == rule) != (getattr(self, key) is not None):
                raise ValueError(f'{key}: goes with objective = "{rule}", and only with it')
        if self.cross_check == self.solver:
            raise ValueError('cross_check: must be another solver than dwell.solver, or "" for none')
        return self


class JobSection(ConfigSection):
    """What is to be reached, and with how much effort."""

    id: Name
    """The job's name: a run folder has it, and a daemon that is started again goes on with the same."""
    tolerance_nm: Positive | None = None
    """RMS in the clear aperture at which the part is done: the short form of a `[[tolerance]]` with `rms_nm`."""
    tolerance_period_mm: NotNegative = 0.0
    """Period above which `tolerance_nm` counts; 0: all periods."""
    accept_by: Accept | None = None
    """By what an RMS is accepted: as it was measured (`figure`), by the one-sided 95 % bound of the part's own RMS, or
    by that bound without power, which the certificate then says. Left out: `bound` where the instrument's profile has
    a system map, else `figure`."""
    lsf_period_mm: Positive = 33.0
    """Period above which the low-frequency figure (`lsf_rms_nm`) counts."""
    max_cycles: Annotated[int, Field(ge=1, le=100)] = 4
    """Most passes; after the last a measurement still decides. [1]"""
    approve: bool = False
    """Each plan waits for a person's `polishd approve` before its pass; nothing moves before."""
    stream_ahead_s: Annotated[float, Field(ge=0.2, le=600)] = 8.0
    """Wall seconds of motion that are sent ahead: enough to lift the tool while the robot still moves."""


class MemorySection(ConfigSection):
    """What a job takes over from the jobs before it (docs/beliefs.md)."""

    use_previous: bool = True
    """Begin a job with what the last pass of its series has taught: the same tool, process, robot and instrument."""
    tool: Text | None = None
    """Name of the tool on the spindle: under another name all is learned anew."""


class CertificateSection(ConfigSection):
    """Who issues certificates of this cell's parts (docs/certificate.md)."""

    shop: str = ""
    """The shop's name, as a certificate has it."""
    key: Text | None = None
    """File of the shop's private key, made by `polishd report keygen`, which signs certificates. Left out: they are not
    signed."""


class LimitsSection(ConfigSection):
    """What must never happen to the part."""

    force_band: Share = 0.25
    """How far the force may be off what was asked, relative; outside for `force_alarm_delay_s` is a safety stop. [1]"""
    force_alarm_delay_s: Annotated[float, Field(ge=0, le=10)] = 0.3
    """How long it may be outside."""
    max_removal_nm: Positive = 1000.0
    """Most that one pass may remove at any point; a plan beyond it is refused."""
    excess_nm: Positive | None = None
    """Most that may be removed beyond the plan at any place because the robot is slower than planned; contact is left
    before. Left out: the larger of half of the tolerance and a tenth of what is planned at that place."""
    max_stall_removal_nm: Positive = 10.0
    """Deepest pit that an operator's feed hold may dig before the force is off, where the robot's controller tells of
    it in its reports only; a cell whose robot could dig deeper is refused."""
    max_pass_s: Positive = 86400.0
    """Longest process time of one pass. A day by default: a metre's pass takes 17 h, and one with a removal rate
    that is wrong by the unit's factor of 100 takes days."""
    max_rate_change: Share = 0.4
    """How far from 1 a learned removal rate may be, relative: beyond it the limit is taken, and where two standard
    errors do not explain that, the cell is held. [1]"""
    max_rate_drift: Share = _FINDING.max_rate_drift
    """How far the removal rate may move during one pass, or from that of the first passes of this process, relative:
    beyond it, and surely so, the cell is held. [1]"""
    max_spot_change: Share = _FINDING.max_spot_change
    """How much wider or narrower than the model's the spot may be, relative; likewise. [1]"""
    min_improvement: ShareOrNone = _FINDING.min_improvement
    """Least share of the predicted gain in RMS that a pass must bring: two in a row that bring less end the job as
    stalled; 0: none does. [1]"""

    @property
    def finding(self) -> FindingLimits:
        """What is looked for in the passes, and beyond what."""
        return FindingLimits(self.max_rate_drift, self.max_spot_change, self.min_improvement)


# What a cell's file says of a part's seat, and of what happens between passes.


class TouchOffSection(ConfigSection):
    """Height and seat of the part, proved before contact: left out, nobody proves them."""

    force_n: Annotated[float, Field(gt=0, le=0.8)] = 0.8
    """Force with which the tool rests on each place, its spindle at rest; a quarter more is let pass, 1 N at most."""
    force_max_n: Annotated[float, Field(gt=1, le=10)] = 2.0
    """Largest force that any device may read in a touch-off: one reading above it, or a rise that would pass it before
    the next one, leaves contact at once."""
    position_mm: Positive | None = None
    """Position of the actuator, in contact with that force, where the tool's tip is where the program says; left out:
    half of `actuator.stroke_mm`."""
    max_offset_mm: Positive = 0.3
    """Farthest that any point of the part may sit from where `part` says. The tool is driven no deeper than that."""
    points_mm: Annotated[tuple[Pair, Pair, Pair] | None, BeforeValidator(as_tuple)] = None
    """Three places (x, y) on the part or its ring, outside the clear aperture; left out: on the middle of the rim that
    `part.edge_mm` leaves out."""
    each_pass: bool = False
    """Whether the part leaves its seat to be measured: then it is proved before each pass, else before the first one
    after a start, a hold or an interruption."""


class StepSection(ConfigSection):
    """A step that a person or a command does, tool up and robot at rest."""

    operator: Text | None = None
    """What a person is asked to do: the cell is held until `polishd resume`."""
    command: Texts = ()
    """Program and arguments, run in the folder of the cell's file; done when it ends with 0."""
    timeout_s: Seconds = 600.0
    """Longest that the command may take; it is killed then."""

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.operator is None) == (not self.command):
            raise ValueError('operator: say who does it: operator = "wipe the part", or command = ["./wash.sh"]')
        return self


class SettleSection(ConfigSection):
    """Maps are taken until two in a row agree within the instrument's noise; the last one counts."""

    wait_s: Annotated[float, Field(ge=0, le=86400)] = 60.0
    """Between two maps."""
    max_maps: Annotated[int, Field(ge=2, le=1000)] = 10
    """Most maps of one measurement; where none agrees with the one before, the cell is held. [1]"""


class BetweenSection(ConfigSection):
    """What happens between passes: each table that is there."""

    clean: StepSection | None = None
    """Before the part is measured."""
    settle: SettleSection | None = None
    """While it is measured, the first time too."""
    condition: StepSection | None = None
    """Of the pad, before the next pass."""
    change: StepSection | None = None
    """Of the tool, where there are [tools]; its name is in `POLISHD_TOOL`. Left out: a person mounts it."""


# ``[signals.NAME]``: what a signal of the cell must be before contact and in it, and what it leads to.


class BoundsSection(ConfigSection):
    """What a signal must be: a state, or a range."""

    min: float | None = None
    """Least that it may be. [in `unit`]"""
    max: float | None = None
    """Most that it may be. [in `unit`]"""
    state: bool | None = None
    """What a signal that is on or off must be."""

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if self.state is None and self.min is None and self.max is None:
            raise ValueError("says nothing; write min, max, or state")
        if self.state is not None and (self.min, self.max) != (None, None):
            raise ValueError("state: goes without min and max; a signal is a state or a number")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError("min: must be at most max")
        return self

    @property
    def bounds(self) -> SignalRange:
        """As they are judged."""
        return SignalRange(self.min, self.max, self.state)


class BeforeSection(BoundsSection):
    """What it must be before contact: the cell waits for that, and is then held."""

    wait_s: Annotated[float, Field(ge=0, le=3600)] = 30.0
    """How long it is waited for."""


class InContactSection(BoundsSection):
    """What it must be in contact."""

    alarm_delay_s: Annotated[float, Field(ge=0, le=600)] = 0.5
    """How long it may be otherwise, or not known."""


class SignalSection(ConfigSection):
    """A signal of the cell that is watched: slurry flow, a pressure, a guard (docs/monitors.md)."""

    monitor: Name | None = None
    """Which of several monitors tells it: `plc` of `[monitor.plc]`."""
    signal: Text | None = None
    """How the monitor calls it; left out: as its section is named."""
    unit: str = ""
    """Of its values, for messages."""
    measures: Literal["force"] | None = None
    """It measures the force on the part, in N: one value above `process.force_max_n` (in a touch-off
    `touch_off.force_max_n`) leaves contact at once, whatever else is asked of it."""
    before: BeforeSection | None = None
    in_contact: InContactSection | None = None
    on_start: BoundsSection | None = None
    """What it must be when a person orders motion, wherever from: the key at the cell that says it is clear. Else
    `resume` and `approve` are refused."""
    action: SignalAction = "hold"
    """What follows in contact: people are told and it goes on; contact is left, and the cell is held; or its daemon
    ends as after any safety stop; or motion stops at once, whatever the part costs."""

    @model_validator(mode="after")
    def _is_watched(self) -> Self:
        if self.measures == "force" and self.unit not in {"", "N"}:
            raise ValueError(f'unit: is {self.unit!r}, and a signal that measures the force has "N"')
        if (self.before, self.in_contact, self.on_start, self.measures) == (None, None, None, None):
            raise ValueError("nothing is asked of it; write before = {...}, in_contact = {...}, or both")
        if self.in_contact is None and "action" in self.model_fields_set:
            raise ValueError("action: goes with in_contact; what is not so before contact holds the cell")
        return self

    def limits(self, name: str) -> SignalLimits:
        """As the daemon watches it."""
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
