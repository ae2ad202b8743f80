"""Pytest plugin: run the suites' tests on a module's ``CASES``, and show the port's requirement of a failed test.

With ``--cell`` suites without cases run on the devices of that cell. Pytest loads this plugin wherever polishd is
installed: it imports polishd only when a suite or a cell needs it.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Generator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

SUITES = "polishd.testing.suites"
FIXTURES = ("any_device", "robot", "actuator", "spindle", "loader", "force_sensor", "monitor")
"""Fixtures of the suites that yield the rig of a case; ``any_device`` is for the common tests of all devices."""
MARKS = {
    "polishd_cuts": "cuts the link",
    "polishd_mutes": "mutes the peer",
    "polishd_fresh": "needs a device that was just powered up",
    "polishd_moves": "moves the device, or may move it, without pressing",
    "polishd_presses": "puts the tool on the part",
    "polishd_cycles": "polishes",
}

LEVELS = ("identify", "no-contact", "contact", "cycle")
BENCH = pytest.StashKey[Any]()
"""The cell, a ``HilBench``."""

pytest.register_assert_rewrite(SUITES)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of ``polishd hil``."""
    group = parser.getgroup("polishd", "polishd: a real cell under the suites (docs/how-to/hil.md)")
    group.addoption("--cell", type=Path, metavar="CELL.toml", help="cell whose devices are tested")
    group.addoption("--hil-level", choices=LEVELS, default="identify", help="level: %(choices)s (%(default)s)")
    group.addoption("--hil-max-force", type=float, metavar="N", help="force limit, required from contact on")
    group.addoption("--hil-simulate", default="", metavar="NAME,...", help="devices to simulate")
    group.addoption("--hil-motion", type=Path, metavar="PROGRAM", help="program that the robot may run in the air")
    group.addoption("--hil-record", type=Path, metavar="FILE|DIR", help="file or folder to record the devices' links")


def pytest_configure(config: pytest.Config) -> None:
    """Register the marks of the suites' tests, and lock the cell until the end."""
    for mark, meaning in MARKS.items():
        config.addinivalue_line("markers", f"{mark}: {meaning}")
    if config.getoption("--cell") is None:
        return
    from polishd.model.errors import PolishdError
    from polishd.testing.hil_bench import asked_in, bench

    stack = ExitStack()
    config.add_cleanup(stack.close)
    try:
        config.stash[BENCH] = stack.enter_context(bench(asked_in(config)))
    except PolishdError as error:
        raise pytest.UsageError(str(error)) from error


def pytest_report_header(config: pytest.Config) -> list[str]:
    """Describe the motion before it begins."""
    if BENCH not in config.stash:
        return []
    from polishd.testing.hil_bench import words

    return list(words(config.stash[BENCH]))


@pytest.fixture
def rig_folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a test's rig.

    Not ``tmp_path``: after a Ctrl-C while a rig is built or left, pytest 9 ends with its KeyError and exit code 1.
    """
    return tmp_path_factory.mktemp(re.sub(r"\W", "_", request.node.name)[:30])


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makeitem(obj: object) -> None:
    """Mark the suites' tests as asyncio tests in every mode of pytest-asyncio."""
    marks = getattr(obj, "pytestmark", [])
    if _of_suites(obj) and inspect.iscoroutinefunction(obj) and "asyncio" not in {mark.name for mark in marks}:
        pytest.mark.asyncio(obj)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run every test of the module's suites for each of its ``CASES``, or for each device of the cell."""
    if not _of_suites(metafunc.function):
        return
    given, cell = getattr(metafunc.module, "CASES", None), metafunc.config.stash.get(BENCH, None)
    for name in (name for name in FIXTURES if name in metafunc.fixturenames):
        cases = cell.cases(name) if given is None and cell is not None else given
        if cases is not None:
            metafunc.parametrize(name, cases, indirect=True, ids=_name)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect a cell's tests above the level."""
    cell = config.stash.get(BENCH, None)
    if cell is None:
        return
    too_far = [
        item for item in items if _on_cell(item) and not cell.allows({mark.name for mark in item.iter_markers()})
    ]
    items[:] = [item for item in items if item not in too_far]
    config.hook.pytest_deselected(items=too_far)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Assign links that a test opens to its device of the cell, for a recording."""
    device = _device(item)
    if device is None or BENCH not in item.config.stash:
        return (yield)
    from polishd.util.wire_recording import record_sent

    with record_sent(device):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the port's requirement to a failure."""
    report = yield
    function: Any = getattr(item, "function", None)
    if report.failed and _of_suites(function):
        report.sections.insert(0, ("requirement of the port", inspect.getdoc(function) or ""))
    return report


def _of_suites(obj: object) -> bool:
    return str(getattr(obj, "__module__", "")).startswith(SUITES)


def _on_cell(item: pytest.Item) -> bool:
    """Whether it is a suite's test on the cell of ``--cell``, or on one of its devices."""
    of_cell = "cell" in getattr(item, "fixturenames", ()) or _device(item) is not None
    return of_cell and _of_suites(getattr(item, "function", None))


def _device(item: pytest.Item) -> str | None:
    """Return the device of the cell that it tests, or None."""
    given = getattr(getattr(item, "callspec", None), "params", {})
    return next((case.device for case in map(given.get, FIXTURES) if hasattr(case, "device")), None)


def _name(case: object) -> str:
    return str(getattr(case, "__name__", case))
