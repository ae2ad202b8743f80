"""The error tree. Each class is named by what happens next, and carries the exit code of the command line.

Those marked * hold the daemon if no pass was under way: the operator corrects the cause, and it continues
(docs/reference/errors.md). All others end it::

    PolishdError
      ConfigError         nothing was opened: correct the file                        (3)
        JournalDamage     the journal of a cell is damaged: its daemon comes up held
        TokenRefused      a shop refuses the token of a cell: write another one
      PluginError         nothing was opened: correct or remove the plugin            (3)
      ProgramError        nothing was written: correct the program                    (9)
      PlanRefused         nothing moved: the plan is not safe                         (4)
      SurfaceError *      measure again                                               (8)
        StaleMap          measured before the last pass ended
        MapError          not readable, or not valid
        WrongPart         it shows another part
        PartNotSettled    no two maps in a row agree within the instrument's noise
      RemovalCheckStop *  a pass did not do what its plan predicted                   (10)
      ToolStop *          the tool is not what plans assume                           (10)
      ComputeError        fall back, or stop before the run                           (10)
      DeviceError *       a device is the cause                                       (5)
        LinkError         the link is dead or silent
          NoDaemon        no daemon runs for this cell
        ProtocolError     the device answers, against its protocol
        DeviceRefused     the device refused the command
          DeviceBusy      it serves another client: a start waits for its watchdog
            DeviceClaimed another program on this computer uses it: stop that one
        DeviceFault       the device reports a fault
        HostFault         the cell's computer is near a limit
        SignalFault       a signal of the cell is out of range
      SafetyStop          the cell left contact without a command                     (7)
        ForcesApart       actuator and force sensor differ
      HandlingError *     the operator must attend to part or pad                     (11)
        WrongSeat         the part is not seated correctly
          SeatNotLeft     the robot could not leave the touch-off position
"""

from __future__ import annotations


class PolishdError(Exception):
    """Root of the tree. The message says what, where and what to do, in one paragraph."""

    exit_code = 1
    mendable = False
    """A person can mend the cause while the daemon waits, held; it is so only where no pass was under way."""


class ConfigError(PolishdError):
    """The configuration is wrong; nothing was opened."""

    exit_code = 3


class NoSuchResource(ConfigError):
    """The cell has no such job, map, plan or file: the HTTP answer is 404."""


class JournalDamage(ConfigError):
    """Rows, pages or commits of a cell's journal are damaged; it is left as it is, and nothing was opened."""


class TokenRefused(ConfigError):
    """A shop does not take the token of a cell."""


class PluginError(PolishdError):
    """A plugin is missing, broken or named twice; nothing was opened."""

    exit_code = 3


class ProgramError(PolishdError):
    """An RNC program cannot be read or rewritten without guessing; nothing was written."""

    exit_code = 9


class PlanRefused(PolishdError):
    """A plan was vetoed before anything moved."""

    exit_code = 4


class SurfaceError(PolishdError):
    """A surface map cannot drive polishing; another one is needed."""

    exit_code = 8
    mendable = True


class StaleMap(SurfaceError):
    """The map is older than the pass it should judge, or was taken already."""


class MapError(SurfaceError):
    """The map's file is broken, unreadable or implausible."""


class WrongPart(SurfaceError):
    """The map shows another part than the job's."""


class PartNotSettled(SurfaceError):
    """Maps of a part at rest continue to change."""


class RemovalCheckStop(PolishdError):
    """A mistake in instrument or alignment explains the measured removal better than the plan."""

    exit_code = 10
    mendable = True


class ToolStop(PolishdError):
    """Passes show a tool that wore, a removal rate that drifted, or another spot."""

    exit_code = 10
    mendable = True


class ComputeError(PolishdError):
    """A computation failed, ran out of time, or came without a valid certificate."""

    exit_code = 10
    point: int | None = None
    """Index of the timed point at which it failed first."""


class WorkerError(ComputeError):
    """A worker process exceeded a limit, ended, or broke the protocol. It has been ended."""


class DeviceError(PolishdError):
    """A device, or the link to it, is the cause."""

    exit_code = 5
    mendable = True


class LinkError(DeviceError):
    """The link is dead or silent."""


class NoDaemon(LinkError):
    """No daemon runs for that state folder: only the command line says so."""

    mendable = False


class ProtocolError(DeviceError):
    """The peer answered outside the protocol."""


class DeviceRefused(DeviceError):
    """The device understood the command and refused it."""


class DeviceBusy(DeviceRefused):
    """The device serves another client, which may be an earlier run of ours; its own watchdog lets go of that."""


class DeviceClaimed(DeviceBusy):
    """Another program of ours on this computer uses that address; nothing was sent to the device."""


class DeviceFault(DeviceError):
    """The device reports an internal fault."""


class HostFault(DeviceError):
    """The computer of the cell, or its disk, nears a limit: contact is left before that is reached."""


class SignalFault(DeviceError):
    """A monitored signal is out of its limits before or during contact."""


class SafetyStop(PolishdError):
    """A limit was crossed in contact; force was taken off, the tool lifted, then motion stopped."""

    exit_code = 7


class ForcesApart(SafetyStop):
    """An independent sensor's word on the force was too far from the actuator's, or the set point, for too long."""


class HandlingError(PolishdError):
    """A step beside polishing is a person's, or failed; nothing is in contact."""

    exit_code = 11
    mendable = True


class WrongSeat(HandlingError):
    """A touch-off found the part too high, too low, tilted, or not at all; nothing was polished."""


class SeatNotLeft(WrongSeat):
    """A touch-off found no part, and the robot stands there still."""


class BatchRequestError(PolishdError):
    """A request to the batch plant that cannot be served."""


class FrameError(PolishdError):
    """A message between a program and a worker process is broken or too large, and the next one cannot be found."""
