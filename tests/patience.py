"""Time limits that a busy machine does not break: those of ``polishd.testing``."""

from polishd.testing.helpers import SOON_S, OwnClock, waits, within

__all__ = ["SOON_S", "OwnClock", "waits", "within"]
