"""Nouns that all layers share: surface, program, events, errors, devices, estimates, outline, tolerance, states."""
