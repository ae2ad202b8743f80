"""Record of a part of a soak."""

from __future__ import annotations

from dataclasses import dataclass, field

LATE_S = 0.5
"""Waiting time for a processor within a second above which the machine is too slow, of a device or the daemon."""
DEVICE_FAULTS = ("LinkError", "DeviceFault", "SafetyStop", "HostFault", "ProtocolError", "DeviceRefused")


@dataclass(slots=True)
class Record:
    """Record of one part in JSON types."""

    number: int
    part: str
    script: str
    session: str
    life: str = ""
    """Identification of the daemon process that ended the part."""
    age: int = 0
    """Number of parts that this daemon has ended before."""
    verdict: str = ""
    fault: str = ""
    reason: str = ""
    visits: int = 0
    """Number of expected visits of the operator."""
    unexpected: list[str] = field(default_factory=list)
    """Reasons of unexpected visits of the operator and of unexpected ends of the daemon."""
    restarts: int = 0
    struck: bool = True
    """Whether the fault of its script occurred."""
    missed: bool = False
    """Whether the fault occurred after the pass, where its effect is unknown."""
    wall_s: float = 0.0
    cpu_s: dict[str, float] = field(default_factory=dict)
    held: dict[str, float] = field(default_factory=dict)
    """Resources of daemon and worker when the part ended, and the size written for it."""
    late_s: float = 0.0
    """Longest time that the daemon or a device waited for a processor between two readings."""
    tolerance_nm: float = 0.0
    measured: dict[str, float] = field(default_factory=dict)
    """Last measurement: ``rms_nm``, ``limit_nm``, ``uncertainty_nm``."""
    true_rms_nm: float = 0.0
    deeper_nm: float = 0.0
    """Largest excess of the depth over the plan."""
    passes: int = 0
    wrong: list[str] = field(default_factory=list)
    """Failures; empty where the part is correct."""

    @property
    def too_slow(self) -> bool:
        """Whether a device seemed silent because the machine delayed all processes."""
        of_devices = [said for said in self.unexpected if any(name in said for name in DEVICE_FAULTS)]
        return self.late_s > LATE_S and (bool(of_devices) or self.fault in DEVICE_FAULTS)
