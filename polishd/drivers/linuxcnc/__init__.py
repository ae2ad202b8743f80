"""LinuxCNC as a robot over linuxcncrsh, and its interpreter as a second program reader (docs/protocols/linuxcnc.md)."""
