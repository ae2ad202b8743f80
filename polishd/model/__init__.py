"""The nouns of a polishing cell: frozen dataclasses with units in their names, and the error tree."""
