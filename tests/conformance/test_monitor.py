"""The Monitor port, over every driver and link."""

from polishd.testing.suites.monitor import *
from tests.conformance.rigs.looking import MONITORS

CASES = MONITORS
