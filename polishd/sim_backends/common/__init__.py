"""What simulated devices share: runtime, wires, framing, faults, mechanics."""
