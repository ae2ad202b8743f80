"""The rule of what ``make test`` leaves out: of many of a kind it runs one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from tests.selection import kind, mark_others_full


class Case:
    """Parts of a test's case that the rule uses."""

    def __init__(self, name: str, *marks: Any, **params: Any) -> None:
        self.nodeid = f"{name}[{params}]"
        self.marks = {mark.name: mark for mark in marks}
        if params:
            self.callspec = SimpleNamespace(params=params)

    def get_closest_marker(self, name: str) -> Any:
        return self.marks.get(name)

    def add_marker(self, mark: Any) -> None:
        self.marks[mark.name] = mark


def kept(*cases: Case) -> list[int]:
    """Which of them ``make test`` runs."""
    mark_others_full(list(cases))  # type: ignore[arg-type]
    return [number for number, case in enumerate(cases) if "full" not in case.marks]


def test_the_first_case_stays() -> None:
    one = pytest.mark.one_of_each
    assert kept(Case("a", one, x=1), Case("a", one, x=2), Case("b", one, x=2), Case("c", x=1), Case("c", x=2)) == [
        0,
        2,
        3,
        4,
    ]


def test_the_first_of_each_kind_stays() -> None:
    one = pytest.mark.one_of_each("case.dialect", "after")
    cases = [("rs274", 1), ("rs274", 1), ("rs274", 2), ("fanuc", 1), ("fanuc", 1)]
    assert kept(*(Case("a", one, case=SimpleNamespace(dialect=name), after=after) for name, after in cases)) == [
        0,
        2,
        3,
    ]


def test_a_case_of_the_long_campaigns_is_not_the_one() -> None:
    one = pytest.mark.one_of_each
    assert kept(Case("a", one, pytest.mark.slow, x=1), Case("a", one, x=2), Case("a", one, x=3)) == [0, 1]


def test_a_test_without_cases_is_a_mistake() -> None:
    with pytest.raises(pytest.UsageError, match="one_of_each needs cases"):
        kept(Case("a", pytest.mark.one_of_each("x")))


def test_values_of_a_fixture() -> None:
    first, *others = kind("tcp", "rtu", "ascii")
    assert first == "tcp"
    assert [(other.values, [mark.name for mark in other.marks]) for other in others] == [
        (("rtu",), ["full"]),
        (("ascii",), ["full"]),
    ]
