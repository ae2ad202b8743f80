"""The ForceSensor port, over every driver and link."""

from polishd.testing.suites.force_sensor import *
from tests.conformance.rigs.looking import FORCE_SENSORS

CASES = FORCE_SENSORS
