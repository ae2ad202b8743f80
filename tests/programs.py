"""Small plans for tests that stream them: those of ``polishd.testing``."""

from polishd.testing.helpers import plan_of

__all__ = ["plan_of"]
