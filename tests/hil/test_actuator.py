"""The suite ``actuator`` on the devices of a real cell: ``pytest -m hil --cell CELL.toml``."""

import pytest

from polishd.testing.suites.actuator import *

pytestmark = pytest.mark.hil
