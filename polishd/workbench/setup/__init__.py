"""``polishd init``: a new cell from answers."""
