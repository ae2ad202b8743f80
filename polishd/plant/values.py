"""What a variable is told: a value with its status, or a status alone."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from asyncua import ua

Status = ua.StatusCodes


def good(value: Any) -> ua.DataValue:
    """As it is now."""
    return stated(value if isinstance(value, ua.Variant) else ua.Variant(value), Status.Good, datetime.now(UTC))


def nothing(status: int) -> ua.DataValue:
    """No value, and why there is none."""
    return stated(ua.Variant(None), status, datetime.now(UTC))


# asyncua's types ask for its own kinds of numbers and times, and it takes Python's.


def stated(value: ua.Variant, status: Any, told: Any) -> ua.DataValue:
    """With that status, and the time at which it was told."""
    now: Any = datetime.now(UTC)
    return ua.DataValue(value, ua.StatusCode(status), told, now)


def node_id(identifier: Any, namespace: Any) -> ua.NodeId:
    """Of a node."""
    return ua.NodeId(identifier, namespace)
