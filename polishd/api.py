"""The one import for plugin authors: hooks, records, nouns, ports and errors."""

from polishd.hookspecs import (
    API_VERSION,
    DeviceContext,
    DeviceType,
    DwellSolver,
    NotifierType,
    ProgramFormat,
    RemovalAnswer,
    RemovalModel,
    RemovalRequest,
    SurfaceReader,
    hookimpl,
    learn_rate,
)
from polishd.model import events
from polishd.model.beliefs import Belief, Beliefs, Evidence, Lesson
from polishd.model.concern import Concern, Severity, Standing
from polishd.model.devices import DeviceStatus, Executed, ForceSample, Identity, RobotProgress, SpeedSample
from polishd.model.dwell import Certificate, DwellSolution
from polishd.model.errors import (
    BadMap,
    ComputeError,
    ConfigError,
    DeviceBusy,
    DeviceError,
    DeviceFault,
    DeviceRefused,
    LinkError,
    PlanRefused,
    PluginError,
    PolishdError,
    ProgramError,
    ProtocolError,
    SafetyStop,
    StaleMap,
    SurfaceError,
    WrongPart,
)
from polishd.model.events import Event
from polishd.model.limits import Envelope
from polishd.model.notification import Notification
from polishd.model.process import ComplianceOptions, Correction, MeasuredTif, Optic, Placement, ToolProcess
from polishd.model.program import Plan, Program, Segment
from polishd.model.robot import HybridRobot, MeasuredCompliance, SerialRobot
from polishd.model.surface import Grid, SurfaceMap, SurfaceStats
from polishd.model.times import ActuatorTimes, LoaderTimes, RobotTimes, SpindleTimes
from polishd.ports import ByteStream, Clock, Device, ForceActuator, Loader, Metrology, Robot, Spindle
from polishd.process.convolution import ConvolutionEffect
from polishd.process.dwell.problem import DwellProblem
from polishd.process.effect import Effect, SparseEffect
from polishd.secret import SecretPlace, hide, read_secret

__all__ = [
    "API_VERSION",
    "ActuatorTimes",
    "BadMap",
    "Belief",
    "Beliefs",
    "ByteStream",
    "Certificate",
    "Clock",
    "ComplianceOptions",
    "ComputeError",
    "Concern",
    "ConfigError",
    "ConvolutionEffect",
    "Correction",
    "Device",
    "DeviceBusy",
    "DeviceContext",
    "DeviceError",
    "DeviceFault",
    "DeviceRefused",
    "DeviceStatus",
    "DeviceType",
    "DwellProblem",
    "DwellSolution",
    "DwellSolver",
    "Effect",
    "Envelope",
    "Event",
    "Evidence",
    "Executed",
    "ForceActuator",
    "ForceSample",
    "Grid",
    "HybridRobot",
    "Identity",
    "Lesson",
    "LinkError",
    "Loader",
    "LoaderTimes",
    "MeasuredCompliance",
    "MeasuredTif",
    "Metrology",
    "Notification",
    "NotifierType",
    "Optic",
    "Placement",
    "Plan",
    "PlanRefused",
    "PluginError",
    "PolishdError",
    "Program",
    "ProgramError",
    "ProgramFormat",
    "ProtocolError",
    "RemovalAnswer",
    "RemovalModel",
    "RemovalRequest",
    "Robot",
    "RobotProgress",
    "RobotTimes",
    "SafetyStop",
    "SecretPlace",
    "Segment",
    "SerialRobot",
    "Severity",
    "SparseEffect",
    "SpeedSample",
    "Spindle",
    "SpindleTimes",
    "StaleMap",
    "Standing",
    "SurfaceError",
    "SurfaceMap",
    "SurfaceReader",
    "SurfaceStats",
    "ToolProcess",
    "WrongPart",
    "events",
    "hide",
    "hookimpl",
    "learn_rate",
    "read_secret",
]
