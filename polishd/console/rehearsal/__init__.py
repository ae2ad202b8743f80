"""``polishd sim --from CELL.toml``: the simulated cell of that very cell, and the cell's file with its addresses."""
