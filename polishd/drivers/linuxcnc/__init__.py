"""LinuxCNC: docs/protocols/linuxcnc.md. ``driver`` runs it over linuxcncrsh, ``interpreter`` only reads programs."""
