"""A shop of several cells: its parts, recipes, queue and history in one database, and each cell's link to it."""
