"""The hooks of polishd and the records that they return. Hooks are synchronous: they declare or judge; devices act.

A plugin is a module (or object) that implements any of these with ``@hookimpl`` from ``polishd.api`` and says
``POLISHD_API = 1``. It is registered through the entry-point group ``polishd`` and loaded when the config names it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pluggy

from polishd.interfaces import Device
from polishd.model.dwell import DwellSolution
from polishd.model.errors import MapError, SurfaceError
from polishd.model.estimates import UNTAUGHT, Estimates, EstimateUpdate, PassEvidence
from polishd.model.events import Event
from polishd.model.instrument import Instrument
from polishd.model.notification import Notification
from polishd.model.outline import Outline
from polishd.model.process import (
    FLAT,
    SHIPPED_OPTIONS,
    ComplianceOptions,
    Correction,
    MeasuredTif,
    Optic,
    Placement,
    RobotModel,
    ToolProcess,
)
from polishd.model.program import Envelope, Plan, Program
from polishd.model.surface import FloatArray, Grid, SurfaceMap
from polishd.process.dwell.problem import DwellProblem
from polishd.process.identification import removal_fit
from polishd.process.metrology.conditioning import drop_implausible
from polishd.process.removal.effect import Effect
from polishd.process.removal.transfer_function import SpotTransferFunction

API_VERSION = 1
PROJECT = "polishd"

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@dataclass(frozen=True, slots=True)
class DeviceType:
    """A kind of device that the config can name: ``[robot] type = "robot_link"``."""

    name: str
    port: str
    """A section for devices: ``robot``, ``actuator``, ``spindle``, ``metrology``, ``loader``, ``force_sensor`` or
    ``monitor``.
    """
    options: type[Any]
    """A pydantic model: the keys of the device's config section besides ``type``."""
    build: Callable[[Any, DeviceContext], Device]
    """Make the device from validated options. Opens nothing."""
    takes: Callable[[Sequence[bytes]], str] | None = None
    """Of a robot: (blocks of a program) -> why it could not run them, empty where it could; None: nobody can say."""
    own_lines: Callable[[Any, DeviceContext], OwnLines] | None = None
    """Of a robot: (validated options, context) -> the lines that its driver adds to a program; None: it adds none.
    ``polishd check`` refuses a program in whose format these lines mean something else."""
    program_format: str = ""
    """Robot: the only program format that its controller reads; empty: several."""
    usual_address: str = ""
    """Address that ``polishd init`` proposes."""
    simulated_by: str = ""
    """``SimDevice.name`` of the simulated device that speaks the same protocol; empty: there is none."""
    simulation_speed: float = 10.0
    """Robot: process seconds per wall second that its simulated controller and its driver can keep up with."""
    substitute: Mapping[str, Any] | None = None
    """The simulated device can take the place of any device of this port: keys of its section besides ``type`` and
    ``address``, for a busy computer. None: it cannot. One device type a port has them."""


@dataclass(frozen=True, slots=True)
class OwnLines:
    """Lines that a robot's driver adds to a program."""

    source: str
    """Where they come from, for messages."""
    dwells: Mapping[float, str]
    """By the seconds for which the controller is to rest there."""
    stops: Sequence[str]
    """Lines at which it is to stop, or at which the program is to end."""


@dataclass(frozen=True, slots=True)
class DeviceContext:
    """What a device may need of its cell besides its own options."""

    base_dir: Path
    """Folder that relative paths in the config start from."""
    state_dir: Path
    part_id: str
    readers: Sequence[SurfaceReader]
    """All surface readers of the loaded plugins, for metrology devices."""
    instrument: Instrument | None = None
    """The instrument's profile, for metrology devices; None: the config names none."""


@dataclass(frozen=True, slots=True)
class ProgramFormat:
    """A program format: reads and rewrites, refuses with ProgramError, never guesses.

    All callables run in the compute worker: they and the record must be picklable (module-level functions).
    """

    name: str
    read: Callable[[bytes, str], Program]
    """(file content, name for messages) -> Program."""
    rewrite: Callable[[Program, FloatArray], bytes]
    """(program, (n,) seconds) -> file content; changes only numbers that carry time."""
    make: Callable[[FloatArray, FloatArray, float, str], bytes] | None = None
    """((n, 3) points in mm, (n, 3) unit tool axes, mm/min, name) -> content of a program along them that rises from
    the last one and ends, by way of a safe height to the first; None where no programs are made in this format."""
    misreads: Callable[[OwnLines], str] | None = None
    """(lines that a robot's driver adds) -> the first that means something else in this format, and what; empty: none.
    None: the format does not know."""


NO_MAP = b"?\n"
"""The head of a text that is of no format: who takes it goes by its name alone."""


@dataclass(frozen=True, slots=True)
class SurfaceReader:
    """A surface-map format. ``sniff`` sees the first 4096 bytes and the path; ``read`` raises BadMap.

    Readers are asked in the order in which they are declared: those that know a magic number before those that
    judge by name; and those of other distributions before polishd's own, some of which take any text.
    """

    name: str
    sniff: Callable[[bytes, Path], bool]
    read: Callable[[Path], SurfaceMap]
    suffixes: tuple[str, ...] = ()
    """Usual endings of such files (".dat"), lower case: what ``write`` is chosen by."""
    write: Callable[[SurfaceMap], bytes] | None = None
    """Content of a file that holds the map; raises BadMap where the format cannot hold it. None: read only."""
    dates: bool = False
    """Whether such files say when they were measured; else the file system dates them."""

    def surface_of(self, head: bytes, path: Path) -> SurfaceMap | None:
        """The map where the file is of this format, None where it is not: everybody asks a reader through this.

        A date or scale that cannot be is taken off it (``process.metrology.conditioning``).

        Raises:
            SurfaceError: as the reader does, and BadMap, with the file and the reader, for whatever else it raises.
        """
        try:
            if not self.sniff(head, path):
                return None
            surface: object = self.read(path)
        except SurfaceError:
            raise
        except Exception as error:  # a parser may raise anything at all on a broken file
            reason = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(".")
            raise MapError(
                f"{path}: the reader {self.name!r} failed: {reason}; export the map again, or mend the reader's plugin"
            ) from error
        if isinstance(surface, SurfaceMap):
            return drop_implausible(surface, datetime.now(UTC), _written(path))
        raise MapError(
            f"{path}: the reader {self.name!r} gave {type(surface).__name__}, no SurfaceMap; mend its plugin"
        )


def looks_like(readers: Iterable[SurfaceReader], head: bytes, path: Path) -> str:
    """What to do with a text that no reader knows by its name, and one would by its content; "" where none would."""
    if not head or b"\0" in head:  # of other files the magic number is asked, or the name alone
        return ""
    advice = []
    for reader in readers:
        try:
            ending = _ending(reader, head, path)
        except Exception as error:  # noqa: BLE001  a plugin's reader may raise anything; the file is refused all the same
            advice.append(
                f"; the reader {reader.name!r} failed on it ({type(error).__name__}: {error}): mend its plugin"
            )
            continue
        if ending:
            advice.append(f"; it looks like {reader.name}: name it *{ending} (or polishd map --format {ending[1:]})")
    return "".join(advice)


def _ending(reader: SurfaceReader, head: bytes, path: Path) -> str:
    """Under which the reader would take the file, and not any text; "" for none."""
    for suffix in reader.suffixes:
        other = path.parent / f"map{suffix}"
        if reader.sniff(head, other) and not reader.sniff(NO_MAP, other):
            return suffix
    return ""


def _written(path: Path) -> datetime | None:
    try:
        return datetime.fromtimestamp(int(path.stat().st_mtime), UTC)
    except (OSError, ValueError, OverflowError):  # gone, or of a year that no date can hold
        return None


@dataclass(frozen=True, slots=True)
class RemovalRequest:
    """What a removal model is asked: the effect of dwelling at the timed points of a program."""

    program: Program
    grid: Grid
    process: ToolProcess
    robot: RobotModel
    placement: Placement
    correction: Correction
    rate: float
    """Learned removal rate, relative to the model's own."""
    options: ComplianceOptions = SHIPPED_OPTIONS
    optic: Optic = FLAT
    tif: MeasuredTif | None = None
    """The cell's measured TIF (``process.tif``), for models that use one."""
    rim: Outline | None = None
    """The part's rim where it is free; None: the part sits in a flush ring."""
    beliefs: Estimates = UNTAUGHT
    """All that the model believes, its own record (``RemovalModel.beliefs``); ``rate`` is of it."""


@dataclass(frozen=True, slots=True)
class RemovalAnswer:
    """The effect, and what it was derived from, along the path."""

    effect: Effect
    compliance_um_per_n: FloatArray
    """(n,) linear equivalent compliance (paper eq. 43)."""
    gamma: FloatArray
    """(n,) depth ratio (paper eq. 48) as the robot's compliance gives it, whatever the correction uses."""
    notes: tuple[str, ...] = ()
    divide_by: FloatArray | None = None
    """(n,) for "pointwise": ``effect`` is the static one, and the dwell solved with it is divided by this."""
    transfer: SpotTransferFunction | None = None
    """The spot's transfer function: what of a surface is out of its reach; None: not known."""

    def removal_nm(self, time_s: FloatArray) -> FloatArray:
        """(ny, nx) nm that the model says (n,) seconds in the machine remove."""
        return self.effect.removal_nm(time_s if self.divide_by is None else time_s * self.divide_by)


def learn_rate(request: RemovalRequest, evidence: PassEvidence) -> EstimateUpdate:
    """What a model learns that says nothing else: the removal rate."""
    return removal_fit.learn_rate(evidence)


Learn = Callable[[RemovalRequest, PassEvidence], EstimateUpdate]
"""(what the last pass's effect was asked with, what the pass did) -> what is believed after it."""


Later = Callable[[Estimates, float], Estimates]
"""(what the last pass of a job has taught, days since) -> what the next job begins with, on another part."""


@dataclass(frozen=True, slots=True)
class Learner:
    """One way to learn from passes."""

    beliefs: Estimates
    """What is believed before anything was polished. Its class is the record that is kept, and made again from JSON."""
    learn: Learn
    later: Later = removal_fit.rate_for_next_part


@dataclass(frozen=True, slots=True)
class RemovalModel:
    """A removal model: ``hertz_preston`` is polishd's own. Runs in the compute worker; must be picklable."""

    name: str
    effect: Callable[[RemovalRequest], RemovalAnswer]
    beliefs: Estimates = UNTAUGHT
    """What it believes before anything was polished. Its class is the record that is kept, and made again from JSON."""
    learn: Learn = learn_rate
    later: Later = removal_fit.rate_for_next_part
    learners: Mapping[str, Learner] = field(default_factory=dict)
    """Other ways, by the name that ``process.estimates`` gives them; ``effect`` knows the beliefs of each."""


@dataclass(frozen=True, slots=True)
class DwellSolver:
    """A dwell solver. ``solve(problem, within_s)`` runs in the compute worker; must be picklable.

    It returns a feasible solution with an honest certificate also when time is up, or raises ComputeError.
    """

    name: str
    solve: Callable[[DwellProblem, float], DwellSolution]


@dataclass(frozen=True, slots=True)
class NotifierType:
    """A way to reach a person that the config can name: ``[notify.mail] type = "email"``."""

    name: str
    options: type[Any]
    """A pydantic model: the keys of the notifier's section besides ``type``, ``severity`` and ``remind_after_s``."""
    build: Callable[[Any, Path], Callable[[Notification], None]]
    """(validated options, folder that relative paths start from) -> what sends. Sends nothing.

    What sends is called in a thread of its own and may take a minute; whatever it raises, it is called again later
    with the same notification. When, how often, and what is not sent at all is not its affair.
    """


@hookspec
def polishd_device_types() -> Sequence[DeviceType]:
    """Declare kinds of devices."""
    raise AssertionError("a hook specification is not called")


@hookspec
def polishd_program_formats(profiles: Sequence[Path]) -> Sequence[ProgramFormat]:
    """Declare program formats; ``profiles`` are dialects of the user's own (``[program] dialects``), to use or not."""
    raise AssertionError("a hook specification is not called")


@hookspec
def polishd_surface_readers() -> Sequence[SurfaceReader]:
    """Declare surface-map formats."""
    raise AssertionError("a hook specification is not called")


@hookspec
def polishd_removal_models() -> Sequence[RemovalModel]:
    """Declare removal models."""
    raise AssertionError("a hook specification is not called")


@hookspec
def polishd_dwell_solvers() -> Sequence[DwellSolver]:
    """Declare dwell solvers."""
    raise AssertionError("a hook specification is not called")


@hookspec
def polishd_check_plan(plan: Plan, envelope: Envelope) -> Sequence[str]:
    """Judge a plan before anything moves: each string is a violation and a veto; so is any exception."""
    raise AssertionError("a hook specification is not called")


@hookspec
def polishd_on_event(event: Event) -> None:
    """Hear of an event: a record of ``polishd.model.events``. An exception is logged and changes nothing."""
    raise AssertionError("a hook specification is not called")


@hookspec
def polishd_notifiers() -> Sequence[NotifierType]:
    """Declare ways to reach a person."""
    raise AssertionError("a hook specification is not called")


@hookspec
def polishd_cli(app: Any) -> None:
    """Add commands to the ``polishd`` command line (a typer app)."""
    raise AssertionError("a hook specification is not called")
