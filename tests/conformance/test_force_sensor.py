"""The ForceSensor port, over every driver and link."""

from polishd.testing.suites.force_sensor import *
from tests.conformance.rigs.sensors_and_monitors import FORCE_SENSORS

CASES = FORCE_SENSORS
