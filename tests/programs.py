"""Small plans of ``polishd.testing`` for tests that stream them."""

from polishd.testing.helpers import plan_of

__all__ = ["plan_of"]
