"""The simulated force sensor: a load cell that feels what truly acts, and its amplifier."""
