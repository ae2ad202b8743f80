"""What is kept of a part of a soak."""

from __future__ import annotations

from dataclasses import dataclass, field

LATE_S = 0.5
"""Where a device, or the daemon, waited for a processor for so long within a second, the machine is too slow."""
DEVICE_FAULTS = ("LinkError", "DeviceFault", "SafetyStop", "HostFault", "ProtocolError", "DeviceRefused")


@dataclass(slots=True)
class Record:
    """Of one of them; JSON-ready."""

    number: int
    part: str
    script: str
    sitting: str
    life: str = ""
    """The daemon's, as the part ended."""
    age: int = 0
    """Parts that this daemon has ended before."""
    verdict: str = ""
    fault: str = ""
    reason: str = ""
    visits: int = 0
    """Of a person who was expected."""
    unexpected: list[str] = field(default_factory=list)
    """Reasons for which a person came, or the daemon ended, that nobody expected."""
    restarts: int = 0
    struck: bool = True
    """What was to befall it did."""
    missed: bool = False
    """... when its pass was over: then it befell nobody knows whom."""
    wall_s: float = 0.0
    cpu_s: dict[str, float] = field(default_factory=dict)
    held: dict[str, float] = field(default_factory=dict)
    """What daemon and worker held as it ended, and what was written for it."""
    late_s: float = 0.0
    """Longest that the daemon or a device waited for a processor between two looks at it."""
    tolerance_nm: float = 0.0
    told: dict[str, float] = field(default_factory=dict)
    """By the last measurement: ``rms_nm``, ``limit_nm``, ``uncertainty_nm``."""
    true_rms_nm: float = 0.0
    deeper_nm: float = 0.0
    """By how much any place is deeper than planned."""
    passes: int = 0
    wrong: list[str] = field(default_factory=list)
    """What may not be; empty where all is as it should be."""

    @property
    def too_slow(self) -> bool:
        """A device seemed silent because the machine kept everybody waiting."""
        of_devices = [said for said in self.unexpected if any(name in said for name in DEVICE_FAULTS)]
        return self.late_s > LATE_S and (bool(of_devices) or self.fault in DEVICE_FAULTS)
