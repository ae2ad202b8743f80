"""Paths for users without a planner, the demo and tests: rasters and spirals over an aperture, on an optic.

`raster.raster` and `spiral.spiral` take an `apertures.Aperture` and a ``model.process.Optic`` and give points in
running order; `wrist.tool_axes` gives the tool axes along them.
"""
