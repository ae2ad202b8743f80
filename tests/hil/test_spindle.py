"""The suite ``spindle`` on the devices of a real cell: ``pytest -m hil --cell CELL.toml``."""

import pytest

from polishd.testing.suites.spindle import *

pytestmark = pytest.mark.hil
