"""What peers need: those of requirements.txt can be imported, and our simulated devices run for them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.interop.devices import PRESSING, RTU, TCP
from tests.interop.peers import SITE
from tests.system.sim_rig import Cell, cell

# Behind everything of ours: where both have a package, ours is taken.
if SITE.exists() and str(SITE) not in sys.path:
    sys.path.append(str(SITE))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """None of these is in ``make test``, before -m chooses."""
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            item.add_marker(pytest.mark.full)


@pytest.fixture(scope="session")
def devices(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """Voice coil and PLC over TCP, spindle on a serial line."""
    with cell(tmp_path_factory.mktemp("tcp"), PRESSING + TCP) as found:
        yield found


@pytest.fixture(scope="session")
def serial_coil(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """The voice coil on a serial line, the spindle over TCP."""
    with cell(tmp_path_factory.mktemp("rtu"), PRESSING + RTU) as found:
        yield found
