"""Interferometer maps: shown, compared, converted, averaged; an instrument commissioned."""
