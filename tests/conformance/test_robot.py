"""The Robot port, over every driver and link."""

from polishd.testing.suites.robot import *
from tests.conformance.rigs.robots import ROBOTS

CASES = ROBOTS
