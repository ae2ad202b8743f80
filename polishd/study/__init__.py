"""Studies: simulations without a cell, described by a file. Nothing here prints; files are the console's affair."""
