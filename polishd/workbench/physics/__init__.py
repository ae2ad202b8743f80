"""The TIF and the compliance of a cell, as tables and pictures."""
