"""Public API for plugin authors: hooks, records, data types, ports, errors, and building blocks of drivers."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from polishd.hookspecs import (
    API_VERSION,
    DataFileFormat,
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
from polishd.interfaces import (
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
from polishd.model import events
from polishd.model.devices import (
    ActuatorTimes,
    DeviceIdentity,
    DeviceStatus,
    ExecutedBlock,
    ForceSample,
    LoaderTimes,
    MapRefusal,
    MonitorTimes,
    RobotProgress,
    RobotTimes,
    SensedForce,
    SensorTimes,
    Signal,
    SpeedSample,
    SpindleTimes,
    Unpowered,
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
from polishd.model.estimates import Estimate, Estimates, EstimateUpdate, MachineEstimates, MapPixels, PassEvidence
from polishd.model.events import Event
from polishd.model.notification import Notification
from polishd.model.outline import Circle, Polygon
from polishd.model.process import (
    ComplianceOptions,
    Correction,
    HybridRobot,
    MeasuredCompliance,
    MeasuredTif,
    Optic,
    Placement,
    SerialRobot,
    ToolProcess,
)
from polishd.model.program import Envelope, Plan, Program, Segment
from polishd.model.states import CellSafety, OperatorNotice, Severity
from polishd.model.surface import Grid, SurfaceMap, SurfaceStats
from polishd.process.dwell.problem import DwellProblem
from polishd.process.removal.convolution import ConvolutionEffect
from polishd.process.removal.effect import Effect, SparseEffect
from polishd.util.files import SecretPlace, read_secret, redact_secrets

if TYPE_CHECKING:
    from polishd.drivers.transport.address import Address, SerialLine, Tcp, line_address, parse_address
    from polishd.drivers.transport.background import Background, PeriodicTimer, RequestQueue
    from polishd.drivers.transport.claims import claim_address
    from polishd.drivers.transport.lines import NumberedLines, PlainLines
    from polishd.drivers.transport.modbus_link import ModbusLink
    from polishd.drivers.transport.streams import LineReader, open_stream


__all__ = [
    "API_VERSION",
    "ActuatorTimes",
    "Address",
    "Background",
    "ByteStream",
    "CellSafety",
    "Circle",
    "Clock",
    "ComplianceOptions",
    "ComputeError",
    "ConfigError",
    "ConvolutionEffect",
    "Correction",
    "DataFileFormat",
    "Device",
    "DeviceBusy",
    "DeviceClaimed",
    "DeviceContext",
    "DeviceError",
    "DeviceFault",
    "DeviceIdentity",
    "DeviceRefused",
    "DeviceStatus",
    "DeviceType",
    "DwellProblem",
    "DwellSolution",
    "DwellSolver",
    "Effect",
    "Envelope",
    "Estimate",
    "EstimateUpdate",
    "Estimates",
    "Event",
    "ExecutedBlock",
    "ForceActuator",
    "ForceSample",
    "ForceSensor",
    "Grid",
    "HybridRobot",
    "Learner",
    "LineReader",
    "LinkError",
    "LoaderTimes",
    "MachineEstimates",
    "MapError",
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
    "OperatorNotice",
    "Optic",
    "OptimalityCertificate",
    "OwnLines",
    "PartLoader",
    "PassEvidence",
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
    "hookimpl",
    "learn_rate",
    "line_address",
    "open_stream",
    "parse_address",
    "read_secret",
    "redact_secrets",
]

_TRANSPORT = {
    "transport.modbus_link": ("ModbusLink",),
    "transport.address": (
        "Address",
        "SerialLine",
        "Tcp",
        "line_address",
        "parse_address",
    ),
    "transport.background": (
        "Background",
        "PeriodicTimer",
        "RequestQueue",
    ),
    "transport.claims": ("claim_address",),
    "transport.lines": (
        "NumberedLines",
        "PlainLines",
    ),
    "transport.streams": (
        "LineReader",
        "open_stream",
    ),
}

if not TYPE_CHECKING:  # otherwise every misspelt name of this module would be Any

    def __getattr__(name: str) -> Any:
        """Import the building blocks of drivers at their first use: commands without devices need no asyncio."""
        for module, names in _TRANSPORT.items():
            if name in names:
                return getattr(import_module(f"polishd.drivers.{module}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
