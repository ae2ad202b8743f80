"""The ForceActuator port, over every driver and link."""

from polishd.testing.suites.actuator import *
from tests.conformance.rigs.actuators import ACTUATORS

CASES = ACTUATORS
