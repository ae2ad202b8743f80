"""What all devices have in common, over every port, driver and link."""

from polishd.testing.suites.device import *
from tests.conformance.rigs import ACTUATORS, LOADERS, ROBOTS, SPINDLES

CASES = [*ROBOTS, *ACTUATORS, *SPINDLES, *LOADERS]
