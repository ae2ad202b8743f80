"""The plant: the true surface, and what wears it."""
