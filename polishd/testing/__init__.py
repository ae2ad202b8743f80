"""Test suites of the ports for driver authors, as a pytest plugin (docs/drivers.md). Needs ``polishd[testing]``."""
