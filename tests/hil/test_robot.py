"""The suite ``robot`` on the devices of a real cell: ``pytest -m hil --cell CELL.toml``."""

import pytest

from polishd.testing.suites.robot import *

pytestmark = pytest.mark.hil
