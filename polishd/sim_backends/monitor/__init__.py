"""The simulated monitor: a box of inputs, and what happens to them."""
