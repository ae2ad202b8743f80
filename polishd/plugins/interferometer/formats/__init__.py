"""Map formats, one module each but for Zygo's; every one ends in its ``SurfaceReader``."""
