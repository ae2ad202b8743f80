"""What all devices have in common, over every port, driver and link."""

from polishd.testing.suites.device import *
from tests.conformance.rigs import ACTUATORS, FORCE_SENSORS, LOADERS, MONITORS, ROBOTS, SPINDLES

CASES = [*ROBOTS, *ACTUATORS, *SPINDLES, *LOADERS, *FORCE_SENSORS, *MONITORS]
