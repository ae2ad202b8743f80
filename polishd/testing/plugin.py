"""The pytest plugin: it has the suites' tests run on a module's ``CASES``, and tells what a port demands.

Every pytest beside an installed polishd loads it, so it imports nothing of polishd before a suite asks for it.
"""

from __future__ import annotations

import inspect
from collections.abc import Generator
from typing import Any

import pytest

SUITES = "polishd.testing.suites"
FIXTURES = ("any_device", "robot", "actuator", "spindle", "loader", "force_sensor", "monitor")
"""The suites' fixtures that give the rig of a case; ``any_device`` is for what all devices have in common."""
MARKS = {
    "polishd_cuts": "cuts the link",
    "polishd_mutes": "has the peer fall silent",
    "polishd_moves": "moves something, and presses nothing",
    "polishd_presses": "puts the tool on the part",
}

pytest.register_assert_rewrite(SUITES)


def pytest_configure(config: pytest.Config) -> None:
    """The marks of the suites' tests."""
    for mark, meaning in MARKS.items():
        config.addinivalue_line("markers", f"{mark}: {meaning}")


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makeitem(obj: object) -> None:
    """The suites' tests are coroutines, whatever the mode of pytest-asyncio is."""
    marks = getattr(obj, "pytestmark", [])
    if _of_suites(obj) and inspect.iscoroutinefunction(obj) and "asyncio" not in {mark.name for mark in marks}:
        pytest.mark.asyncio(obj)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Each of the module's ``CASES`` is a case of every test of the suites that it has imported."""
    cases = getattr(metafunc.module, "CASES", None)
    if cases is None or not _of_suites(metafunc.function):
        return
    for name in FIXTURES:
        if name in metafunc.fixturenames:
            metafunc.parametrize(name, cases, indirect=True, ids=_name)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A failure comes with what the port demands."""
    report = yield
    function: Any = getattr(item, "function", None)
    if report.failed and _of_suites(function):
        report.sections.insert(0, ("what the port demands", inspect.getdoc(function) or ""))
    return report


def _of_suites(obj: object) -> bool:
    return str(getattr(obj, "__module__", "")).startswith(SUITES)


def _name(case: object) -> str:
    return str(getattr(case, "__name__", case))
