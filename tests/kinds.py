"""Which tests ``make test`` leaves out: of many of a kind it runs one.

``@pytest.mark.full`` marks a test that says again, at length, what others say in ``make test``.
``@pytest.mark.one_of_each("case.dialect")`` marks a test of many cases: the first of each dialect stays, the others
become ``full``. With several names the first of each combination stays, without a name the first of all cases.
``kind(first, *others)`` says the same of a fixture's values. ``make test-all`` runs them all.
"""

from __future__ import annotations

from operator import attrgetter
from types import SimpleNamespace
from typing import Any

import pytest


def kind(first: Any, *others: Any) -> list[Any]:
    """Values of a fixture that are one kind: the first stays, the others are ``full``."""
    return [first, *(pytest.param(other, marks=pytest.mark.full) for other in others)]


def mark_others_full(items: list[pytest.Item]) -> None:
    """Of the cases of each ``one_of_each`` test, mark all but the first of each kind as ``full``."""
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
    """What the case has at ``argument.attribute``."""
    callspec: Any = getattr(item, "callspec", None)
    if callspec is None:
        raise pytest.UsageError(f"{item.nodeid}: one_of_each needs cases")
    return str(attrgetter(name)(SimpleNamespace(**callspec.params)))
