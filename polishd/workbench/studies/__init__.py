"""Studies: simulations without a cell, described by a file."""
