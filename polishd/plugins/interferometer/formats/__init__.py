"""Map formats, one module each; every one ends in its ``SurfaceReader``."""
