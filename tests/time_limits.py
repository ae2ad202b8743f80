"""Time limits of ``polishd.testing``, which suit a busy machine."""

from polishd.testing.helpers import SOON_S, OwnClock, waits, within

__all__ = ["SOON_S", "OwnClock", "waits", "within"]
