"""Select the tests that ``make test`` omits: it runs one of many similar tests.

``@pytest.mark.full`` marks a thorough test of what shorter tests in ``make test`` also check.
``@pytest.mark.one_of_each("case.dialect")`` marks a test of many cases: the first of each dialect stays, the others
become ``full``. With several names the first of each combination stays, without a name the first of all cases.
``kind(first, *others)`` does this for the values of a fixture. ``make test-all`` runs all tests.
"""

from __future__ import annotations

from operator import attrgetter
from types import SimpleNamespace
from typing import Any

import pytest


def kind(first: Any, *others: Any) -> list[Any]:
    """Return values of a fixture of which the first stays in ``make test`` and the others are ``full``."""
    return [first, *(pytest.param(other, marks=pytest.mark.full) for other in others)]


def mark_others_full(items: list[pytest.Item]) -> None:
    """Mark the cases of each ``one_of_each`` test as ``full``, except the first of each kind."""
    seen = set()
    for item in items:
        mark = item.get_closest_marker("one_of_each")
        if mark is None or item.get_closest_marker("slow"):
            continue
        kind = (item.nodeid.partition("[")[0], *(_kind(name, item) for name in mark.args))
        if kind in seen:
            item.add_marker(pytest.mark.full)
        seen.add(kind)


def _kind(name: str, item: pytest.Item) -> str:
    """Return the value of ``argument.attribute`` of the case."""
    callspec: Any = getattr(item, "callspec", None)
    if callspec is None:
        raise pytest.UsageError(f"{item.nodeid}: one_of_each needs cases")
    return str(attrgetter(name)(SimpleNamespace(**callspec.params)))
