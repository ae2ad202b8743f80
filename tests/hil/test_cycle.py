"""One cycle of a real cell's own job: ``pytest -m hil --cell CELL.toml --hil-level cycle --hil-max-force N``."""

import pytest

from polishd.testing.suites.cycle import *

pytestmark = pytest.mark.hil
