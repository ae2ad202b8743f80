"""The part's rim: the surface beyond it, the spot that overhangs it, and what no dwell reaches."""
