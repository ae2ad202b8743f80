"""Tool paths, their spacing, and the apertures that they cover."""
