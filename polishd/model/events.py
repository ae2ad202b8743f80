"""Base of the daemon's events and all kinds of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass
from typing import Annotated, Any, ClassVar

from polishd.model.devices import DeviceIdentity
from polishd.model.dwell import OptimalityCertificate
from polishd.model.part_handling import PartSeat
from polishd.model.states import NOT_ASKED, CellSafety, OperatorNotice, Severity
from polishd.model.surface import SurfaceStats


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """An event of the daemon. Each kind is one class, identified by ``name``."""

    name: ClassVar[str]
    cycle: Annotated[int | None, "the cycle in which it happened; None outside of all"] = None

    @property
    def data(self) -> Mapping[str, Any]:
        """Its own fields by name, as the socket and the journal have them; those of a record or mapping one by one."""
        found: dict[str, Any] = {}
        for name in (item.name for item in fields(self) if item.name != "cycle"):
            value = _plain(getattr(self, name))
            found |= value if isinstance(value, Mapping) else {name: value}
        return found

    def facts(self) -> dict[str, Any]:
        """``{"name", "cycle", "data"}``, as a subscriber gets it."""
        return {"name": self.name, "cycle": self.cycle, "data": dict(self.data)}

    def concern(self) -> OperatorNotice | None:
        """Return None: the event needs no operator."""
        return None


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


# What happens between a cell and its shop.


@dataclass(frozen=True, slots=True, kw_only=True)
class ShopRateReceived(Event):
    """The shop sent another cell's estimates of a recipe; a job begins with them if this cell has none."""

    name: ClassVar[str] = "shop_rate_received"
    recipe: Annotated[str, "hash of process and tool"]
    cell: Annotated[str, "name of the other cell"]
    job: Annotated[str, "its job"]
    of_cycle: Annotated[int, "cycle of the pass"]
    at_s: Annotated[float, "Unix time of the estimate"]
    rate: Annotated[float, "removal rate, relative to the model's own"]
    sigma: Annotated[float, "its standard error on that cell's machine"]


# What happens in a cell: one record an event, for ``polishd_on_event``, the socket's subscribers, journal and log.


@dataclass(frozen=True, slots=True, kw_only=True)
class JobStarted(Event):
    """A job of the queue begins, or continues after a restart; its part is loaded next."""

    name: ClassVar[str] = "job_started"
    job: Annotated[str, "its `job.id`"]
    part_id: Annotated[str, "its part"]
    run_dir: Annotated[str, "the run folder"]


STANDING = (
    "`tool_off`: `yes`, `not confirmed` or `not asked`; `robot_at_rest`: the same; `unsafe`: each device that did not "
    "confirm that it is safe: `name: why`; `next`: what the operator can do"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PartRequested(Event):
    """The operator must load a part; nothing moves before."""

    name: ClassVar[str] = "part_requested"
    job: Annotated[str, "the `job.id` of its job"]
    part_id: Annotated[str, "the part"]
    standing: Annotated[CellSafety, STANDING]

    def concern(self) -> OperatorNotice:
        """Warning; alarm if a device did not confirm that it is safe."""
        what = f"{self.job}: a person is to put part {self.part_id!r} in"
        return self.standing.concern(Severity.WARNING, what, "it waits for that")


@dataclass(frozen=True, slots=True, kw_only=True)
class PartChanged(Event):
    """The loader or the operator reports the part of a job on the seat; its map still has to prove it."""

    name: ClassVar[str] = "part_changed"
    part_id: Annotated[str, "the part"]
    by: Annotated[str, "`loader` or `a person`"]


@dataclass(frozen=True, slots=True, kw_only=True)
class QueueJobEnded(Event):
    """A job of the queue ended."""

    name: ClassVar[str] = "queue_job_ended"
    job: Annotated[str, "its `job.id`"]
    part_id: Annotated[str, "its part"]
    verdict: Annotated[str, "`accepted`, `rejected` or `set aside`"]
    reason: Annotated[str, "why"]
    stops: Annotated[str, "why the queue stops because of it; empty if it continues"]
    run_dir: Annotated[str, "the run folder; empty if the job did not begin"]

    def concern(self) -> OperatorNotice:
        """Info if accepted, else warning."""
        severity = Severity.INFO if self.verdict == "accepted" else Severity.WARNING
        what = f"{self.job} (part {self.part_id}) was {self.verdict}: {self.reason}"
        does = f"the queue stops: {self.stops}" if self.stops else "the queue goes on"
        return OperatorNotice(severity, what, does, "polishd queue list CELL.toml shows the queue")


@dataclass(frozen=True, slots=True, kw_only=True)
class QueueStopped(Event):
    """The daemon of a queue ends without an error."""

    name: ClassVar[str] = "queue_stopped"
    outcome: Annotated[str, "`empty`, `stopped`, or the outcome of the job because of which it stopped"]
    reason: Annotated[str, "why it was stopped; else empty"]
    jobs: Annotated[str, "number of jobs of this run by result"]
    standing: Annotated[CellSafety, "as of `state`"]

    def concern(self) -> OperatorNotice:
        """Info; alarm if a device did not confirm that it is safe."""
        what = ": ".join(filter(None, [f"queue: {self.outcome}", self.reason]))
        return self.standing.concern(Severity.INFO, f"{what}; jobs: {self.jobs}", "the daemon has ended")


@dataclass(frozen=True, slots=True, kw_only=True)
class CellOpened(Event):
    """All devices of the cell are open and identified."""

    name: ClassVar[str] = "cell_opened"
    devices: Annotated[Mapping[str, DeviceIdentity], "by name: `vendor`, `model`, `serial`, `firmware`, `boot_id`"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StateChanged(Event):
    """The state of the daemon changed."""

    name: ClassVar[str] = "state_changed"
    state: Annotated[str, "`starting`, `idle`, `changing`, `polishing`, `held` or `finished`"]
    reason: Annotated[str, "why the cell is held, or how the job ended"]
    standing: Annotated[CellSafety, STANDING]

    def concern(self) -> OperatorNotice | None:
        """Warning if the cell is held; alarm if a device did not confirm that it is safe."""
        if self.state != "held":
            return None
        return self.standing.concern(Severity.WARNING, f"held: {self.reason}", "it is held, and waits for a person")


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReceived(Event):
    """The daemon received a command over its socket."""

    name: ClassVar[str] = "command_received"
    order: Annotated[str, "`hold`, `resume`, `stop` or `estop`, or a command to the queue, such as `queue_move`"]
    reason: Annotated[str, "reason that the sender gave; may be empty"]
    by: Annotated[str, "name of the sender, as reported by the program that passed it on; empty: not stated"] = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmAcknowledged(Event):
    """A user acknowledged alarms."""

    name: ClassVar[str] = "alarm_acknowledged"
    alarms: Annotated[Sequence[int], "their numbers in the journal's table `event`"]
    by: Annotated[str, "name of the user"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactAborted(Event):
    """An error in contact: the tool is being lifted; `cell_held` or `daemon_failed` follows when the cell is safe."""

    name: ClassVar[str] = "contact_aborted"
    error: Annotated[str, "what is wrong"]
    kind: Annotated[str, "the error's class"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CellHeld(Event):
    """An error that the operator can correct holds the cell, or any error ends a job of the queue."""

    name: ClassVar[str] = "cell_held"
    error: Annotated[str, "what is wrong, and what to do"]
    kind: Annotated[str, "the error's class"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DaemonFailed(Event):
    """An error ended the daemon."""

    name: ClassVar[str] = "daemon_failed"
    error: Annotated[str, "what was wrong, and what to do"]
    kind: Annotated[str, "the error's class"]
    standing: Annotated[CellSafety, "as of `state`"] = NOT_ASKED

    def concern(self) -> OperatorNotice:
        """Alarm."""
        return self.standing.concern(Severity.ALARM, f"failed: {self.kind}: {self.error}", "the daemon has ended")


@dataclass(frozen=True, slots=True, kw_only=True)
class MapRefused(Event):
    """A map was refused, and the cell waits for another one; repeated while no map arrives."""

    name: ClassVar[str] = "map_refused"
    file: Annotated[str, "name of the file"]
    kind: Annotated[str, "the error's class: `MapError`, `StaleMap`, `WrongPart`"]
    reason: Annotated[str, "reason of the refusal"]
    todo: Annotated[str, "what to do"]
    kept: Annotated[str, "folder in which the file is kept; empty if it could not be moved"]
    waited_s: Annotated[float, "seconds since the refusal: 0 at first, then every 10 minutes"] = 0.0

    def concern(self) -> OperatorNotice:
        """Warning: the operator must measure again."""
        since = f", refused {self.waited_s / 60:.0f} min ago" if self.waited_s else ""
        waits = "the cell measures: it waits for another map; nothing moves"
        return OperatorNotice(
            Severity.WARNING, f"map {self.file} refused: {self.kind}: {self.reason}{since}", waits, self.todo
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class MapMeasured(Event):
    """A map was read and conditioned."""

    name: ClassVar[str] = "map_measured"
    stats: Annotated[
        SurfaceStats,
        "nm: `rms_nm`, `pv_nm`, `lsf_rms_nm`, `band_rms_nm` (None if all periods count); `samples`",
    ]
    judged: Annotated[
        Sequence[Mapping[str, Any]],
        "each line of the tolerance: `what`, `value`, `limit`, `unit`, `uncertainty` (None: not known), `with_ripple`, "
        "`with_ripple_high` (None: no ripple is hidden), `bound`, `guard` (None: judged as measured), `removed`, "
        "`holds`",
    ] = ()
    spikes: Annotated[int, "number of samples that were rejected as spikes"]
    notes: Annotated[Sequence[str], "remarks on the map"]
    run_dir: Annotated[str, "the run folder"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapRepeated(Event):
    """The measurement was repeated, to find changes that no pass made: a part that settles, or its mount."""

    name: ClassVar[str] = "map_repeated"
    maps: Annotated[int, "maps of this measurement so far"]
    change_nm: Annotated[float, "RMS of the difference from the previous map, or of its largest low order"]
    limit_nm: Annotated[float, "largest permitted change"]
    notes: Annotated[Sequence[str], "the same in words"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RemovalCheckFailed(Event):
    """The removal check stopped the cell: the map disagrees with the removal of the last pass."""

    name: ClassVar[str] = "removal_check_failed"
    stop: Annotated[str, "reason, and what to do"]
    cycle_dir: Annotated[str, "the cycle's folder, for `gate.png`"]


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatesUpdated(Event):
    """The estimates were updated by the measured removal of the last pass."""

    name: ClassVar[str] = "estimates_updated"
    beliefs: Annotated[
        Mapping[str, Any],
        "`rate`, relative to the model's own; `block_overhead_s` that a block takes beyond its motion; further "
        "estimates of the removal model",
    ]
    notes: Annotated[Sequence[str], "remarks on the estimates"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalOutOfRange(Event):
    """A signal of the cell is out of its range, before contact or in it."""

    name: ClassVar[str] = "signal_out_of_range"
    signal: Annotated[str, "its name: `flow` of `[signals.flow]`"]
    what: Annotated[str, "its value and its limits"]
    action: Annotated[str, "`wait` before contact; in contact `notify`, `hold`, `lift` or `estop`"]

    def concern(self) -> OperatorNotice | None:
        """Warning if the reaction is only a notification; other reactions raise their events."""
        if self.action != "notify":
            return None
        return OperatorNotice(Severity.WARNING, self.what, "it goes on polishing", "look at it before the pass ends")


@dataclass(frozen=True, slots=True, kw_only=True)
class FindingReported(Event):
    """The last passes show a stall, a drift, a worn tool or another spot."""

    name: ClassVar[str] = "finding_reported"
    kind: Annotated[str, "`stall`, `drift`, `wear` or `spot`"]
    what: Annotated[str, "description, and what to do"]
    stops: Annotated[str, "`job`: this job ends; `cell`: no job continues until the operator has checked the tool"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DwellSolved(Event):
    """The dwell of the next pass was solved."""

    name: ClassVar[str] = "dwell_solved"
    certificate: Annotated[
        OptimalityCertificate,
        "`predicted_rms_nm`, `kkt_residual`, `dwell_total_s` and the other fields of `certificate.json`",
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolMounted(Event):
    """Another tool is on the spindle: the operator who resumed, or the command that changes tools, confirmed it."""

    name: ClassVar[str] = "tool_mounted"
    tool: Annotated[str, "its name in `[tools]`"]
    notes: Annotated[Sequence[str], "the same in words"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PartTouchedOff(Event):
    """The touch-off measured height and tilt of the part at three points."""

    name: ClassVar[str] = "part_touched_off"
    seat: Annotated[
        PartSeat,
        "`height_mm` of the center above its nominal height; `tilt_deg` about x and y; `off_mm` of each point; "
        "`worst_mm`: largest offset of any point of the part",
    ]
    max_offset_mm: Annotated[float, "largest permitted offset"]
    notes: Annotated[Sequence[str], "the same in words"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanAwaitingApproval(Event):
    """A plan waits for `polishd approve`; nothing moves before (`job.approve`)."""

    name: ClassVar[str] = "plan_awaiting_approval"
    program_sha256: Annotated[str, "hash of its program"]
    program: Annotated[str, "name of the program that it rewrites; empty if the tool has one"] = ""
    predicted_rms_nm: Annotated[float, "predicted RMS after the pass, nm"]
    dwell_s: Annotated[float, "planned time in contact, s"]
    figures: Annotated[
        Mapping[str, Any] | None,
        "figures for the approval: `before_rms_nm`, `expected_nm`, `ripple_rms_nm`, `removal_mean_nm`, `limits`, "
        "`notes` and the other fields of `PlanFigures`",
    ] = None
    plan: Annotated[str, "name of its arrays in the journal's store"] = ""

    def concern(self) -> OperatorNotice:
        """Warning."""
        what = f"a plan of {self.dwell_s / 60:.1f} min to {self.predicted_rms_nm:.2f} nm waits for approval"
        return OperatorNotice(Severity.WARNING, what, "nothing moves", "look at it, then: polishd approve CELL.toml")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanApproved(Event):
    """The operator approved the waiting plan."""

    name: ClassVar[str] = "plan_approved"
    program_sha256: Annotated[str, "hash of its program"]
    by: Annotated[str, "name of the user"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PassStarted(Event):
    """The journal has the begin of a pass; the robot starts next."""

    name: ClassVar[str] = "pass_started"
    blocks: Annotated[int, "sequence number of the first block after contact"]
    dwell_s: Annotated[float, "planned time in contact, s"]
    forecast: Annotated[
        Mapping[str, Any] | None,
        "expected RMS of the next map, nm: `low_nm`, `median_nm`, `high_nm`; probability `level` of this interval, and "
        "`better`, of an improvement; null: not known",
    ] = None
    tool: Annotated[str, "the tool that polishes; empty if the cell has one tool"] = ""
    program: Annotated[str, "name of the program of this pass; empty if the tool has one"] = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class PassProgressed(Event):
    """Further blocks were executed in contact."""

    name: ClassVar[str] = "pass_progressed"
    block: Annotated[int, "blocks executed so far"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PassEnded(Event):
    """A pass ended: tool lifted, robot at rest."""

    name: ClassVar[str] = "pass_ended"
    executed_s: Annotated[float, "time in contact by the robot's clock, s"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunFolderCompleted(Event):
    """The run of a job ended; the run folder is complete."""

    name: ClassVar[str] = "run_folder_completed"
    run_dir: Annotated[str, "the run folder"]
    outcome: Annotated[
        str, "`in_tolerance`, `cycles_used`, `as_programmed`, `diverged`, `stalled`, `stopped` or `failed`"
    ]
    reason: Annotated[str, "why it was stopped or failed, or the result in a queue; else empty"] = ""
    standing: Annotated[CellSafety | None, "as of `state`; None if the daemon continues"] = None

    def concern(self) -> OperatorNotice | None:
        """Info if in tolerance or stopped, else warning; alarm if a device did not confirm. Not sent if failed."""
        if self.standing is None or self.outcome == "failed":
            return None
        severity = Severity.INFO if self.outcome in {"in_tolerance", "stopped"} else Severity.WARNING
        what = ": ".join(filter(None, [self.outcome, self.reason]))
        return self.standing.concern(severity, what, "the daemon has ended")


@dataclass(frozen=True, slots=True, kw_only=True)
class NotificationFailed(Event):
    """A notifier failed. Raised once until it has sent all waiting notifications, and when some are given up."""

    name: ClassVar[str] = "notification_failed"
    notifier: Annotated[str, "its name: `mail` of `[notify.mail]`"]
    error: Annotated[str, "reason"]
    waiting: Annotated[int, "number of waiting notifications"]
    given_up: Annotated[int, "number of notifications that were given up, and are only in the log"] = 0

    def concern(self) -> OperatorNotice:
        """Warning, through the other notifiers."""
        lost = f"; given up: {self.given_up}" if self.given_up else ""
        return OperatorNotice(
            Severity.WARNING,
            f"notifications by {self.notifier!r} fail: {self.error}",
            f"the cell goes on; waiting until it works again: {self.waiting}{lost}",
            f"mend what it names or [notify.{self.notifier}]; polishd notify CELL.toml tries it",
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanWritten(Event):
    """`polishd plan` wrote its folder, without a daemon."""

    name: ClassVar[str] = "plan_written"
    run_dir: Annotated[str, "the plan's folder"]


EVENTS: tuple[type[Event], ...] = (
    CellOpened,
    StateChanged,
    CommandReceived,
    AlarmAcknowledged,
    CellHeld,
    DaemonFailed,
    JobStarted,
    PartRequested,
    PartChanged,
    MapRefused,
    MapMeasured,
    MapRepeated,
    RemovalCheckFailed,
    EstimatesUpdated,
    FindingReported,
    DwellSolved,
    ToolMounted,
    PartTouchedOff,
    SignalOutOfRange,
    PlanAwaitingApproval,
    PlanApproved,
    PassStarted,
    PassProgressed,
    ContactAborted,
    PassEnded,
    RunFolderCompleted,
    QueueJobEnded,
    QueueStopped,
    NotificationFailed,
    ShopRateReceived,
    PlanWritten,
)
"""Every kind, in the order in which they come in a job."""
