"""The computing steps of a cycle: condition, learn, solve, plan; recipe, records, acceptance, decisions."""
