"""The Loader port, over every driver and link."""

from polishd.testing.suites.loader import *
from tests.conformance.rigs.loaders import LOADERS

CASES = LOADERS
