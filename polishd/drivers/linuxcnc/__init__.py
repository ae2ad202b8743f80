"""LinuxCNC: docs/protocols/linuxcnc.md. ``driver`` moves it over linuxcncrsh, ``interpreter`` only reads programs."""
