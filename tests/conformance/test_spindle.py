"""The Spindle port, over every driver and link."""

from polishd.testing.suites.spindle import *
from tests.conformance.rigs.spindles import SPINDLES

CASES = SPINDLES
