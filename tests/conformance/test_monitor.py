"""The Monitor port, over every driver and link."""

from polishd.testing.suites.monitor import *
from tests.conformance.rigs.sensors_and_monitors import MONITORS

CASES = MONITORS
