"""Map formats, one file each; each ends in its ``SurfaceReader``."""
