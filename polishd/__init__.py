"""polishd: the controller daemon of an unattended robotic polishing cell for optics."""

__version__ = "0.1.0"
