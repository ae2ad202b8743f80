"""For whoever writes a driver: the ports' suites as a pytest plugin (docs/drivers.md). Needs ``polishd[testing]``."""
