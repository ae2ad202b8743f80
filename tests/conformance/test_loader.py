"""The Loader port, over every driver and link."""

from polishd.testing.suites.loader import *
from tests.conformance.rigs import LOADERS

CASES = LOADERS
