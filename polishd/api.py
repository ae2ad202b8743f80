"""The one import for plugin authors: hooks, records, nouns, ports, errors, and what drivers are made of."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from polishd.hookspecs import (
    API_VERSION,
    DeviceContext,
    DeviceType,
    DwellSolver,
    Learner,
    NotifierType,
    OwnLines,
    ProgramFormat,
    RemovalAnswer,
    RemovalModel,
    RemovalRequest,
    SurfaceReader,
    hookimpl,
    learn_rate,
)
from polishd.model import events
from polishd.model.beliefs import Estimate, Estimates, EstimateUpdate, MachineEstimates, MapPixels, PassEvidence
from polishd.model.concern import CellSafety, OperatorNotice, Severity
from polishd.model.devices import (
    DeviceIdentity,
    DeviceStatus,
    ExecutedBlock,
    ForceSample,
    MapRefusal,
    RobotProgress,
    SensedForce,
    Signal,
    SpeedSample,
)
from polishd.model.dwell import DwellSolution, OptimalityCertificate
from polishd.model.errors import (
    ComputeError,
    ConfigError,
    DeviceBusy,
    DeviceClaimed,
    DeviceError,
    DeviceFault,
    DeviceRefused,
    LinkError,
    MapError,
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
from polishd.model.outline import Circle, Polygon
from polishd.model.process import ComplianceOptions, Correction, MeasuredTif, Optic, Placement, ToolProcess
from polishd.model.program import Plan, Program, Segment
from polishd.model.robot import HybridRobot, MeasuredCompliance, SerialRobot
from polishd.model.surface import Grid, SurfaceMap, SurfaceStats
from polishd.model.times import (
    ActuatorTimes,
    LoaderTimes,
    MonitorTimes,
    RobotTimes,
    SensorTimes,
    SpindleTimes,
    Unpowered,
)
from polishd.ports import (
    ByteStream,
    Clock,
    Device,
    ForceActuator,
    ForceSensor,
    Metrology,
    Monitor,
    PartLoader,
    Robot,
    Spindle,
)
from polishd.process.convolution import ConvolutionEffect
from polishd.process.dwell.problem import DwellProblem
from polishd.process.effect import Effect, SparseEffect
from polishd.secret import SecretPlace, hide, read_secret

if TYPE_CHECKING:
    from polishd.drivers.profiled.modbus_link import ModbusLink
    from polishd.drivers.transport.address import Address, SerialLine, Tcp, line_address, parse_address
    from polishd.drivers.transport.background import Background
    from polishd.drivers.transport.claims import claim_address
    from polishd.drivers.transport.numbered import NumberedLines
    from polishd.drivers.transport.pace import PeriodicTimer
    from polishd.drivers.transport.plain import PlainLines
    from polishd.drivers.transport.requests import RequestQueue
    from polishd.drivers.transport.streams import LineReader, open_stream

__all__ = [
    "API_VERSION",
    "ActuatorTimes",
    "Address",
    "Background",
    "MapError",
    "Estimate",
    "Estimates",
    "ByteStream",
    "OptimalityCertificate",
    "Circle",
    "Clock",
    "ComplianceOptions",
    "ComputeError",
    "OperatorNotice",
    "ConfigError",
    "ConvolutionEffect",
    "Correction",
    "Device",
    "DeviceBusy",
    "DeviceClaimed",
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
    "PassEvidence",
    "ExecutedBlock",
    "ForceActuator",
    "ForceSample",
    "ForceSensor",
    "Grid",
    "HybridRobot",
    "DeviceIdentity",
    "Learner",
    "EstimateUpdate",
    "LineReader",
    "LinkError",
    "PartLoader",
    "LoaderTimes",
    "MachineEstimates",
    "MapPixels",
    "MapRefusal",
    "MeasuredCompliance",
    "MeasuredTif",
    "Metrology",
    "ModbusLink",
    "Monitor",
    "MonitorTimes",
    "Notification",
    "NotifierType",
    "NumberedLines",
    "Optic",
    "OwnLines",
    "PeriodicTimer",
    "Placement",
    "PlainLines",
    "Plan",
    "PlanRefused",
    "PluginError",
    "PolishdError",
    "Polygon",
    "Program",
    "ProgramError",
    "ProgramFormat",
    "ProtocolError",
    "RemovalAnswer",
    "RemovalModel",
    "RemovalRequest",
    "RequestQueue",
    "Robot",
    "RobotProgress",
    "RobotTimes",
    "SafetyStop",
    "SecretPlace",
    "Segment",
    "SensedForce",
    "SensorTimes",
    "SerialLine",
    "SerialRobot",
    "Severity",
    "Signal",
    "SparseEffect",
    "SpeedSample",
    "Spindle",
    "SpindleTimes",
    "StaleMap",
    "CellSafety",
    "SurfaceError",
    "SurfaceMap",
    "SurfaceReader",
    "SurfaceStats",
    "Tcp",
    "ToolProcess",
    "Unpowered",
    "WrongPart",
    "claim_address",
    "events",
    "hide",
    "hookimpl",
    "learn_rate",
    "line_address",
    "open_stream",
    "parse_address",
    "read_secret",
]

_TRANSPORT = {
    "profiled.modbus_link": ("ModbusLink",),
    "transport.address": ("Address", "SerialLine", "Tcp", "line_address", "parse_address"),
    "transport.background": ("Background",),
    "transport.claims": ("claim_address",),
    "transport.numbered": ("NumberedLines",),
    "transport.pace": ("Pace",),
    "transport.plain": ("PlainLines",),
    "transport.requests": ("RequestQueue",),
    "transport.streams": ("LineReader", "open_stream"),
}

if not TYPE_CHECKING:  # or every misspelt name of this module would be Any

    def __getattr__(name: str) -> Any:
        """What drivers are made of is imported when it is first asked for: commands without devices need no asyncio."""
        for module, names in _TRANSPORT.items():
            if name in names:
                return getattr(import_module(f"polishd.drivers.{module}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
