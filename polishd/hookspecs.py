"""Hooks of polishd and the records that they return. Hooks are synchronous: they declare or judge; devices act.

A plugin is a module (or object) that implements hooks with ``@hookimpl`` from ``polishd.api`` and sets
``POLISHD_API = 1``. It is registered in the entry-point group ``polishd`` and loaded if the config names it.
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
from polishd.process.removal.ripple import ActingSpots
from polishd.process.removal.transfer_function import SpotTransferFunction

API_VERSION = 1
PROJECT = "polishd"

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@dataclass(frozen=True, slots=True)
class DeviceType:
    """A device type for the config: ``[robot] type = "robot_link"``."""

    name: str
    port: str
    """Config section: ``robot``, ``actuator``, ``spindle``, ``metrology``, ``loader``, ``force_sensor`` or
    ``monitor``.
    """
    options: type[Any]
    """A pydantic model: the keys of the device's config section besides ``type``."""
    build: Callable[[Any, DeviceContext], Device]
    """Build the device from validated options. Opens nothing."""
    takes: Callable[[Sequence[bytes]], str] | None = None
    """Robot: (blocks of a program) -> why it cannot run them, empty if it can; None: no check."""
    takes_with_data_file: Callable[[Sequence[bytes], bytes], str] | None = None
    """Instead of ``takes``, of a robot whose driver also delivers the file beside a program (``Program.beside``):
    (blocks, its content) -> the same. None: the driver delivers the program alone, and a file beside it is refused."""
    own_lines: Callable[[Any, DeviceContext], OwnLines] | None = None
    """Robot: (validated options, context) -> the lines that its driver adds to a program; None: it adds none.
    ``polishd check`` refuses a program in whose format these lines mean something else."""
    program_format: str = ""
    """Robot: the only program format of its controller; empty: several."""
    usual_address: str = ""
    """Address that ``polishd init`` suggests."""
    simulated_by: str = ""
    """``SimDevice.name`` of the simulated device with the same protocol, or ``kind`` of its section; empty: none."""
    simulation_speed: float = 10.0
    """Robot: highest process seconds per wall second of its simulated controller and its driver."""
    substitute: Mapping[str, Any] | None = None
    """Section keys besides ``type`` and ``address`` for a busy computer, if the simulated device can replace any device
    of this port. None: it cannot. Only one device type per port has them."""


@dataclass(frozen=True, slots=True)
class OwnLines:
    """Lines that a robot's driver adds to a program."""

    source: str
    """Source of the lines, for messages."""
    dwells: Mapping[float, str]
    """Dwell lines, by their time in s."""
    stops: Sequence[str]
    """Lines that stop the robot or end the program."""
    format: str = ""
    """The only format that they go with, if they call programs of the controller. Empty: ``misreads`` judges."""


@dataclass(frozen=True, slots=True)
class DeviceContext:
    """Values of the cell for a device, besides its options."""

    base_dir: Path
    """Base folder of relative paths in the config."""
    state_dir: Path
    part_id: str
    readers: Sequence[SurfaceReader]
    """All surface readers of the loaded plugins, for metrology devices."""
    instrument: Instrument | None = None
    """The instrument's profile, for metrology devices; None: the config names none."""


@dataclass(frozen=True, slots=True)
class DataFileFormat:
    """Programs whose positions are declared in a file beside them."""

    find: Callable[[Path], bytes]
    """(path of the program) -> content of the file beside it; empty: there is none."""
    read: Callable[[bytes, str, bytes], Program]
    """(file content, name for messages, content of the file beside it) -> Program."""


@dataclass(frozen=True, slots=True)
class ProgramFormat:
    """A program format: reads and rewrites programs; refuses with ProgramError, never guesses.

    All callables run in the compute worker: they and the record must be picklable (module-level functions).
    """

    name: str
    read: Callable[[bytes, str], Program]
    """(file content, name for messages) -> Program."""
    rewrite: Callable[[Program, FloatArray], bytes]
    """(program, (n,) seconds) -> file content; changes only numbers that set times."""
    make: Callable[[FloatArray, FloatArray, float, str], bytes] | None = None
    """((n, 3) points in mm, (n, 3) unit tool axes, mm/min, name) -> content of a program that goes to the first
    point by way of a safe height, along the points, and up from the last one; None: the format writes no programs."""
    misreads: Callable[[OwnLines], str] | None = None
    """(lines that a robot's driver adds) -> the first one with another meaning in this format, and that meaning; empty:
    none. None: the format does not know."""
    made_like: Callable[[bytes, str], ProgramFormat] | None = None
    """(content of a program, name for messages) -> this format, whose ``make`` writes for the controller's tool and
    frame of that program; ProgramError where it cannot. None: programs name neither."""
    data_file: DataFileFormat | None = None
    """None: a program is one file."""

    def read_file(self, path: Path, content: bytes) -> Program:
        """Read a program with the file beside it. ProgramError."""
        beside = b"" if self.data_file is None else self.data_file.find(path)
        return self._read(content, path.name, beside)

    def read_rewritten(self, program: Program, content: bytes, name: str) -> Program:
        """Read another text of a program, with the file that was beside the first. ProgramError."""
        return self._read(content, name, program.beside)

    def _read(self, content: bytes, name: str, beside: bytes) -> Program:
        if self.data_file is None or not beside:
            return self.read(content, name)
        return self.data_file.read(content, name, beside)


NO_MAP = b"?\n"
"""Start of a text of no format: a reader that accepts it goes by the file name alone."""


@dataclass(frozen=True, slots=True)
class SurfaceReader:
    """A surface-map format. ``sniff`` sees the first 4096 bytes and the path; ``read`` raises MapError.

    polishd tries readers in the order of their declaration: readers by magic number before readers by name, and those
    of other distributions before polishd's, some of which accept any text.
    """

    name: str
    sniff: Callable[[bytes, Path], bool]
    read: Callable[[Path], SurfaceMap]
    suffixes: tuple[str, ...] = ()
    """Usual endings of such files (".dat"), lower case; they select ``write``."""
    write: Callable[[SurfaceMap], bytes] | None = None
    """(map) -> file content; raises MapError if the format cannot hold it. None: read only."""
    dates: bool = False
    """Whether such files contain their time of measurement; otherwise the file's time is used."""

    def surface_of(self, head: bytes, path: Path) -> SurfaceMap | None:
        """Read the map; None if the file is not of this format. All callers use a reader by this method.

        Removes an impossible date or scale (``process.metrology.conditioning``).

        Raises:
            SurfaceError: From the reader; MapError, with file and reader, for any other exception of the reader.
        """
        try:
            if not self.sniff(head, path):
                return None
            surface: object = self.read(path)
        except SurfaceError:
            raise
        except Exception as error:  # a parser may raise anything on a broken file
            reason = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(".")
            raise MapError(
                f"{path}: the reader {self.name!r} failed: {reason}. Export the map again, or correct its plugin."
            ) from error
        if isinstance(surface, SurfaceMap):
            return drop_implausible(surface, datetime.now(UTC), _written(path))
        raise MapError(
            f"{path}: the reader {self.name!r} returned {type(surface).__name__}, not a SurfaceMap. Correct its plugin."
        )


def looks_like(readers: Iterable[SurfaceReader], head: bytes, path: Path) -> str:
    """Advice for a text that no reader accepts by its name but one would by its content; "" if none would."""
    if not head or b"\0" in head:  # other files are identified by magic number or name
        return ""
    advice = []
    for reader in readers:
        try:
            ending = _ending(reader, head, path)
        except Exception as error:  # noqa: BLE001  a plugin's reader may raise anything; the file is refused all the same
            advice.append(
                f"; the reader {reader.name!r} failed on it ({type(error).__name__}: {error}): correct its plugin"
            )
            continue
        if ending:
            advice.append(f"; it looks like {reader.name}: name it *{ending} (or polishd map --format {ending[1:]})")
    return "".join(advice)


def _ending(reader: SurfaceReader, head: bytes, path: Path) -> str:
    """Return the ending with which the reader would accept this file but not any text; "" for none."""
    for suffix in reader.suffixes:
        other = path.parent / f"map{suffix}"
        if reader.sniff(head, other) and not reader.sniff(NO_MAP, other):
            return suffix
    return ""


def _written(path: Path) -> datetime | None:
    try:
        return datetime.fromtimestamp(int(path.stat().st_mtime), UTC)
    except (OSError, ValueError, OverflowError):  # missing, or of a year that datetime cannot hold
        return None


@dataclass(frozen=True, slots=True)
class RemovalRequest:
    """Request to a removal model: the effect of dwelling at the timed points of a program."""

    program: Program
    grid: Grid
    process: ToolProcess
    robot: RobotModel
    placement: Placement
    correction: Correction
    rate: float
    """Estimated removal rate, relative to the model's."""
    options: ComplianceOptions = SHIPPED_OPTIONS
    optic: Optic = FLAT
    tif: MeasuredTif | None = None
    """Measured TIF of the cell (``process.tif``), for models that use one."""
    rim: Outline | None = None
    """Free rim of the part; None: the part is in a flush ring."""
    beliefs: Estimates = UNTAUGHT
    """All estimates of the model, in its record (``RemovalModel.beliefs``); ``rate`` is one of them."""


@dataclass(frozen=True, slots=True)
class RemovalAnswer:
    """Effect of a program, with its intermediate results along the path."""

    effect: Effect
    compliance_um_per_n: FloatArray
    """(n,) linear equivalent compliance (paper eq. 43)."""
    gamma: FloatArray
    """(n,) depth ratio (paper eq. 48) from the robot's compliance, independent of the correction."""
    notes: tuple[str, ...] = ()
    divide_by: FloatArray | None = None
    """(n,) for "pointwise": ``effect`` is the static one, and the solved dwell is divided by this."""
    transfer: SpotTransferFunction | None = None
    """Transfer function of the spot, which limits the correctable surface errors; None: unknown."""
    acting: ActingSpots | None = None
    """Spots along the path as they act on a dwell in the machine, for the forecast of ripple; None: no forecast."""

    def removal_nm(self, time_s: FloatArray) -> FloatArray:
        """Return the modeled removal, (ny, nx) nm, of (n,) seconds in the machine."""
        return self.effect.removal_nm(time_s if self.divide_by is None else time_s * self.divide_by)


def learn_rate(request: RemovalRequest, evidence: PassEvidence) -> EstimateUpdate:
    """Update the removal rate: the default of models without another ``learn``."""
    return removal_fit.learn_rate(evidence)


Learn = Callable[[RemovalRequest, PassEvidence], EstimateUpdate]
"""(request of the last pass's effect, evidence of the pass) -> updated estimates."""


Later = Callable[[Estimates, float], Estimates]
"""(estimates after a job's last pass, days since) -> initial estimates of the next job, on another part."""


@dataclass(frozen=True, slots=True)
class Learner:
    """One method to update estimates from passes."""

    beliefs: Estimates
    """Initial estimates. Their class is the record that is stored and restored from JSON."""
    learn: Learn
    later: Later = removal_fit.rate_for_next_part


@dataclass(frozen=True, slots=True)
class RemovalModel:
    """A removal model: ``hertz_preston`` is polishd's. Runs in the compute worker; must be picklable."""

    name: str
    effect: Callable[[RemovalRequest], RemovalAnswer]
    beliefs: Estimates = UNTAUGHT
    """Initial estimates. Their class is the record that is stored and restored from JSON."""
    learn: Learn = learn_rate
    later: Later = removal_fit.rate_for_next_part
    learners: Mapping[str, Learner] = field(default_factory=dict)
    """Other methods, by their name in ``process.estimates``; ``effect`` accepts the estimates of each."""


@dataclass(frozen=True, slots=True)
class DwellSolver:
    """A dwell solver. ``solve(problem, within_s)`` runs in the compute worker; must be picklable.

    It returns a feasible solution with a true certificate also at the time limit, or raises ComputeError.
    """

    name: str
    solve: Callable[[DwellProblem, float], DwellSolution]


@dataclass(frozen=True, slots=True)
class NotifierType:
    """A notifier type for the config: ``[notify.mail] type = "email"``."""

    name: str
    options: type[Any]
    """A pydantic model: the keys of the notifier's section besides ``type``, ``severity`` and ``remind_after_s``."""
    build: Callable[[Any, Path], Callable[[Notification], None]]
    """(validated options, base folder of relative paths) -> the send function. Sends nothing.

    polishd calls the send function in a separate thread. It may take a minute; after any exception it is called again
    later with the same notification. polishd decides when, how often, and which notifications are sent.
    """


@hookspec
def polishd_device_types() -> Sequence[DeviceType]:
    """Declare device types."""
    raise AssertionError("a hook specification is not called")


@hookspec
def polishd_program_formats(profiles: Sequence[Path]) -> Sequence[ProgramFormat]:
    """Declare program formats; ``profiles`` are the user's dialects (``[program] dialects``), which it may use."""
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
    """Check a plan before any motion: each returned string is a violation that vetoes the plan; so is any exception."""
    raise AssertionError("a hook specification is not called")


@hookspec
def polishd_on_event(event: Event) -> None:
    """Receive an event: a record of ``polishd.model.events``. An exception is logged and has no other effect."""
    raise AssertionError("a hook specification is not called")


@hookspec
def polishd_notifiers() -> Sequence[NotifierType]:
    """Declare notifier types."""
    raise AssertionError("a hook specification is not called")


@hookspec
def polishd_cli(app: Any) -> None:
    """Add commands to the ``polishd`` command line (a typer app)."""
    raise AssertionError("a hook specification is not called")
