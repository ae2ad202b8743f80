"""What a cell's own tests say of its numbers: stiffnesses from loads, the removal's exponent from spots."""
