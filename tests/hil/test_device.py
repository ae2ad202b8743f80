"""The suite ``device`` on the devices of a real cell: ``pytest -m hil --cell CELL.toml``."""

import pytest

from polishd.testing.suites.device import *

pytestmark = pytest.mark.hil
