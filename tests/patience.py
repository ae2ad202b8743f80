"""Time limits that a busy machine does not break: those of ``polishd.testing``."""

from polishd.testing.patience import SOON_S, OwnClock, waits, within

__all__ = ["SOON_S", "OwnClock", "waits", "within"]
