"""A real LinuxCNC as the cell's robot: only its motors are simulated (docs/protocols/linuxcnc.md)."""
