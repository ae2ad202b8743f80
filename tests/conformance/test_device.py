"""What all devices have in common, over every port, driver and link."""

from polishd.testing.suites.device import *
from tests.conformance.rigs.actuators import ACTUATORS
from tests.conformance.rigs.loaders import LOADERS
from tests.conformance.rigs.robots import ROBOTS
from tests.conformance.rigs.sensors_and_monitors import FORCE_SENSORS, MONITORS
from tests.conformance.rigs.spindles import SPINDLES

CASES = [*ROBOTS, *ACTUATORS, *SPINDLES, *LOADERS, *FORCE_SENSORS, *MONITORS]
