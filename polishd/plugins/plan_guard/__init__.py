"""The last look at a plan before anything moves: every limit of the envelope, and the plan's own consistency."""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import Envelope, Plan, hookimpl
from polishd.plugins.plan_guard.checks import CHECKS

POLISHD_API = 1


@hookimpl
def polishd_check_plan(plan: Plan, envelope: Envelope) -> Sequence[str]:
    """Violations, each with the line and the value; any of them is a veto."""
    return [violation for check in CHECKS for violation in check(plan, envelope)]
