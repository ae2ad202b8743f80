"""Studies: simulations, sweeps and closed loops against simulated plants, described by a file."""
