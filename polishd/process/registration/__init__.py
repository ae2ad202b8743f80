"""Registration: where the part lies in a map, by its fiducials, by its outline, or by both."""

from polishd.process.registration.record import Registration
from polishd.process.registration.register import register
from polishd.process.registration.resampling import resample_registered

__all__ = ["Registration", "register", "resample_registered"]
