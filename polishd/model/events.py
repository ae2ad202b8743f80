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
    """The shop sends another cell's estimates of a recipe; a job begins with them where this cell has none."""

    name: ClassVar[str] = "shop_rate_received"
    recipe: Annotated[str, "of process and tool, a hash"]
    cell: Annotated[str, "which has learned it"]
    job: Annotated[str, "in which job"]
    of_cycle: Annotated[int, "in its pass of that cycle"]
    at_s: Annotated[float, "when, Unix time"]
    rate: Annotated[float, "removal rate, relative to the model's own"]
    sigma: Annotated[float, "its standard error on that cell's machine"]


# What happens in a cell: one record an event, for ``polishd_on_event``, the socket's subscribers, journal and log.


@dataclass(frozen=True, slots=True, kw_only=True)
class JobStarted(Event):
    """A job of the queue begins, or goes on after a restart; its part is put in next."""

    name: ClassVar[str] = "job_started"
    job: Annotated[str, "its `job.id`"]
    part_id: Annotated[str, "its part"]
    run_dir: Annotated[str, "the run folder"]


STANDING = (
    "`tool_off`: `yes`, `not confirmed` or `not asked`; `robot_at_rest`: the same; `unsafe`: each device that did not "
    "confirm being safe: `name: why`; `next`: what a person may do"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PartRequested(Event):
    """A person is to put a part in; nothing moves before."""

    name: ClassVar[str] = "part_requested"
    job: Annotated[str, "the `job.id` of its job"]
    part_id: Annotated[str, "the part"]
    standing: Annotated[CellSafety, STANDING]

    def concern(self) -> OperatorNotice:
        """Warning; alarm where a device did not confirm, too."""
        what = f"{self.job}: a person is to put part {self.part_id!r} in"
        return self.standing.concern(Severity.WARNING, what, "it waits for that")


@dataclass(frozen=True, slots=True, kw_only=True)
class PartChanged(Event):
    """The part of a job is on the seat, as the loader or a person says; its map still has to prove it."""

    name: ClassVar[str] = "part_changed"
    part_id: Annotated[str, "the part"]
    by: Annotated[str, "`loader` or `a person`"]


@dataclass(frozen=True, slots=True, kw_only=True)
class QueueJobEnded(Event):
    """A job of the queue is over."""

    name: ClassVar[str] = "queue_job_ended"
    job: Annotated[str, "its `job.id`"]
    part_id: Annotated[str, "its part"]
    verdict: Annotated[str, "`accepted`, `rejected` or `set aside`"]
    reason: Annotated[str, "why"]
    stops: Annotated[str, "why the queue stops over it; empty where it goes on"]
    run_dir: Annotated[str, "the run folder; empty where the job never began"]

    def concern(self) -> OperatorNotice:
        """Info where accepted, else warning."""
        severity = Severity.INFO if self.verdict == "accepted" else Severity.WARNING
        what = f"{self.job} (part {self.part_id}) was {self.verdict}: {self.reason}"
        does = f"the queue stops: {self.stops}" if self.stops else "the queue goes on"
        return OperatorNotice(severity, what, does, "polishd queue list CELL.toml shows the queue")


@dataclass(frozen=True, slots=True, kw_only=True)
class QueueStopped(Event):
    """The daemon of a queue ends; not where an error ended it."""

    name: ClassVar[str] = "queue_stopped"
    outcome: Annotated[str, "`empty`, `stopped`, or the outcome of the job over which it stopped"]
    reason: Annotated[str, "why it was stopped; else empty"]
    jobs: Annotated[str, "how many jobs of this run ended how"]
    standing: Annotated[CellSafety, "as of `state`"]

    def concern(self) -> OperatorNotice:
        """Info; alarm where a device did not confirm."""
        what = ": ".join(filter(None, [f"queue: {self.outcome}", self.reason]))
        return self.standing.concern(Severity.INFO, f"{what}; jobs: {self.jobs}", "the daemon has ended")


@dataclass(frozen=True, slots=True, kw_only=True)
class CellOpened(Event):
    """All devices of the cell answered with their identity."""

    name: ClassVar[str] = "cell_opened"
    devices: Annotated[Mapping[str, DeviceIdentity], "by name: `vendor`, `model`, `serial`, `firmware`, `boot_id`"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StateChanged(Event):
    """The daemon's state is another one."""

    name: ClassVar[str] = "state_changed"
    state: Annotated[str, "`starting`, `idle`, `changing`, `polishing`, `held` or `finished`"]
    reason: Annotated[str, "why it is held, or how the job ended"]
    standing: Annotated[CellSafety, STANDING]

    def concern(self) -> OperatorNotice | None:
        """Warning where the cell is held; alarm where a device did not confirm, too."""
        if self.state != "held":
            return None
        return self.standing.concern(Severity.WARNING, f"held: {self.reason}", "it is held, and waits for a person")


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReceived(Event):
    """A person, or a program for one, gave an order over the socket."""

    name: ClassVar[str] = "command_received"
    order: Annotated[str, "`hold`, `resume`, `stop` or `estop`, or what was asked of the queue: `queue_move`, say"]
    reason: Annotated[str, "what was said with it; may be empty"]
    by: Annotated[str, "who gave it, by the word of what passed it on; empty: not said"] = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmAcknowledged(Event):
    """A person has seen alarms."""

    name: ClassVar[str] = "alarm_acknowledged"
    alarms: Annotated[Sequence[int], "their numbers in the journal's table `event`"]
    by: Annotated[str, "who"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactAborted(Event):
    """An error in contact: the tool is being lifted; `cell_held` or `daemon_failed` follows once all is safe."""

    name: ClassVar[str] = "contact_aborted"
    error: Annotated[str, "what is wrong"]
    kind: Annotated[str, "the error's class"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CellHeld(Event):
    """An error that a person can mend holds the cell, or any error ends a job of the queue."""

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
    """The instrument's map was refused, and the cell waits for another; again while no map comes."""

    name: ClassVar[str] = "map_refused"
    file: Annotated[str, "name of the file"]
    kind: Annotated[str, "the error's class: `MapError`, `StaleMap`, `WrongPart`"]
    reason: Annotated[str, "why it was refused"]
    todo: Annotated[str, "what to do"]
    kept: Annotated[str, "where the file is kept; empty where it could not be moved"]
    waited_s: Annotated[float, "seconds since it was refused: 0 at first, then every 10 minutes"] = 0.0

    def concern(self) -> OperatorNotice:
        """Warning: the operator must measure again."""
        since = f", refused {self.waited_s / 60:.0f} min ago" if self.waited_s else ""
        waits = "the cell measures: it waits for another map; nothing moves"
        return OperatorNotice(
            Severity.WARNING, f"map {self.file} refused: {self.kind}: {self.reason}{since}", waits, self.todo
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class MapMeasured(Event):
    """A map was taken, and conditioned."""

    name: ClassVar[str] = "map_measured"
    stats: Annotated[
        SurfaceStats,
        "nm: `rms_nm`, `pv_nm`, `lsf_rms_nm`, `band_rms_nm` (None where the whole surface counts); `samples`",
    ]
    judged: Annotated[
        Sequence[Mapping[str, Any]],
        "each line of the tolerance: `what`, `value`, `limit`, `unit`, `uncertainty` (None: not known), `bound`, "
        "`guard` (None: judged as measured), `removed`, `holds`",
    ] = ()
    spikes: Annotated[int, "samples that were taken for spikes"]
    notes: Annotated[Sequence[str], "what a person should know of the map"]
    run_dir: Annotated[str, "the run folder"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapRepeated(Event):
    """Another map was taken, to see whether the part has settled, or what of a pass's change is none of the pass."""

    name: ClassVar[str] = "map_repeated"
    maps: Annotated[int, "maps of this measurement so far"]
    change_nm: Annotated[float, "RMS by which it differs from the one before, or of the largest low order that does"]
    limit_nm: Annotated[float, "what that may be"]
    notes: Annotated[Sequence[str], "the same in words"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RemovalCheckFailed(Event):
    """The removal check stopped the cell: another orientation explains the map better than the last pass."""

    name: ClassVar[str] = "removal_check_failed"
    stop: Annotated[str, "why"]
    cycle_dir: Annotated[str, "the cycle's folder, for `gate.png`"]


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatesUpdated(Event):
    """The last pass was compared with what it removed."""

    name: ClassVar[str] = "estimates_updated"
    beliefs: Annotated[
        Mapping[str, Any],
        "`rate`, relative to the model's own; `block_overhead_s` that a block takes beyond its motion; what else the "
        "removal model believes",
    ]
    notes: Annotated[Sequence[str], "what a person should know of it"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalOutOfRange(Event):
    """A signal of the cell is not as it must be before contact, or in it."""

    name: ClassVar[str] = "signal_out_of_range"
    signal: Annotated[str, "its name: `flow` of `[signals.flow]`"]
    what: Annotated[str, "how it is, and how it must be"]
    action: Annotated[str, "`wait` before contact; in it `notify`, `hold`, `lift` or `estop`"]

    def concern(self) -> OperatorNotice | None:
        """Warning where the reaction is only a notification; other reactions raise their events."""
        if self.action != "notify":
            return None
        return OperatorNotice(Severity.WARNING, self.what, "it goes on polishing", "look at it before the pass ends")


@dataclass(frozen=True, slots=True, kw_only=True)
class FindingReported(Event):
    """The last pass, with those before it, shows a stall, a drift, a worn tool or another spot."""

    name: ClassVar[str] = "finding_reported"
    kind: Annotated[str, "`stall`, `drift`, `wear` or `spot`"]
    what: Annotated[str, "what was found, and what to do"]
    stops: Annotated[str, "`job`: this one does not go on; `cell`: no job should, until a person has seen to the tool"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DwellSolved(Event):
    """The dwell of the next pass was solved."""

    name: ClassVar[str] = "dwell_solved"
    certificate: Annotated[
        OptimalityCertificate,
        "`predicted_rms_nm`, `kkt_residual`, `dwell_total_s` and all else that `certificate.json` has",
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolMounted(Event):
    """Another tool is on the spindle: by the word of a person who resumed, or of the command that changes tools."""

    name: ClassVar[str] = "tool_mounted"
    tool: Annotated[str, "its name in `[tools]`"]
    notes: Annotated[Sequence[str], "the same in words"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PartTouchedOff(Event):
    """The tool met the part at three places, and their heights say how it sits."""

    name: ClassVar[str] = "part_touched_off"
    seat: Annotated[
        PartSeat,
        "`height_mm`: how much too high the centre is; `tilt_deg` about x and y; `off_mm` of each place; `worst_mm`: "
        "most that any point of the part is off",
    ]
    max_offset_mm: Annotated[float, "what that may be"]
    notes: Annotated[Sequence[str], "the same in words"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanAwaitingApproval(Event):
    """A plan waits for a person's `approve`; nothing moves before (`job.approve`)."""

    name: ClassVar[str] = "plan_awaiting_approval"
    program_sha256: Annotated[str, "hash of its program"]
    predicted_rms_nm: Annotated[float, "RMS that it is to leave, nm"]
    dwell_s: Annotated[float, "s in contact, as planned"]
    figures: Annotated[
        Mapping[str, Any] | None,
        "what is approved, one by one: `before_rms_nm`, `expected_nm`, `ripple_rms_nm`, `removal_mean_nm`, `limits`, "
        "`notes` and all else of `PlanFigures`",
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
    by: Annotated[str, "who"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PassStarted(Event):
    """A pass is journalled; the robot starts next."""

    name: ClassVar[str] = "pass_started"
    blocks: Annotated[int, "sequence number of the first block after contact"]
    dwell_s: Annotated[float, "s in contact, as planned"]
    forecast: Annotated[
        Mapping[str, Any] | None,
        "RMS that the next map is expected to show, nm: `low_nm`, `median_nm`, `high_nm`; the chance `level` that it "
        "lies between, and `better`, that it is less than now; null: not known",
    ] = None
    tool: Annotated[str, "of several the one that polishes; empty: the cell has one"] = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class PassProgressed(Event):
    """Some blocks more were executed in contact."""

    name: ClassVar[str] = "pass_progressed"
    block: Annotated[int, "blocks executed so far"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PassEnded(Event):
    """A pass is over: tool lifted, robot at rest."""

    name: ClassVar[str] = "pass_ended"
    executed_s: Annotated[float, "s that were executed in contact, of the robot's own clock"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunFolderCompleted(Event):
    """The run of a job is over, whichever way; the run folder is whole."""

    name: ClassVar[str] = "run_folder_completed"
    run_dir: Annotated[str, "the run folder"]
    outcome: Annotated[
        str, "`in_tolerance`, `cycles_used`, `as_programmed`, `diverged`, `stalled`, `stopped` or `failed`"
    ]
    reason: Annotated[str, "why it was stopped or failed, or what of a queue was decided; else empty"] = ""
    standing: Annotated[CellSafety | None, "as of `state`; None where the daemon goes on"] = None

    def concern(self) -> OperatorNotice | None:
        """Info where in tolerance or stopped, else warning; alarm where a device did not confirm. Not where failed."""
        if self.standing is None or self.outcome == "failed":
            return None
        severity = Severity.INFO if self.outcome in {"in_tolerance", "stopped"} else Severity.WARNING
        what = ": ".join(filter(None, [self.outcome, self.reason]))
        return self.standing.concern(severity, what, "the daemon has ended")


@dataclass(frozen=True, slots=True, kw_only=True)
class NotificationFailed(Event):
    """A notifier failed. Raised once until it has sent all that waits, and when the sender gives up some."""

    name: ClassVar[str] = "notification_failed"
    notifier: Annotated[str, "its name: `mail` of `[notify.mail]`"]
    error: Annotated[str, "why"]
    waiting: Annotated[int, "how many wait for it to work again"]
    given_up: Annotated[int, "how many were too old or too many, and are only in the log"] = 0

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
    """`polishd plan` has written its folder; no daemon is there."""

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
