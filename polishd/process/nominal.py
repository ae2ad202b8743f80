"""The form that is wanted: maps are measured against it."""

from __future__ import annotations

import numpy as np
import scipy

from polishd.model.errors import MapError
from polishd.model.surface import SurfaceMap
from polishd.process.registration.record import Registration


def less_nominal(surface: SurfaceMap, nominal: SurfaceMap, lies: Registration) -> SurfaceMap:
    """The map less the form wanted, so that what is left is the error to polish away.

    Args:
        surface: the map.
        nominal: the form, its array centred on the part and in the part's own directions; finite all over the part.
        lies: where the part lies in the map.

    Returns:
        The map on its own samples; NaN where the form says nothing.

    Raises:
        BadMap: either has no pitch.
    """
    if surface.pitch_mm is None or nominal.pitch_mm is None:
        raise MapError(f"{nominal.path or 'the nominal form'}: it and the map need a lateral scale to be compared")
    grid = nominal.grid
    x, y = lies.on_part_mm(surface.grid)
    places = [(grid.y_mm[0] - y) / grid.pitch_mm, (x - grid.x_mm[0]) / grid.pitch_mm]
    wanted = scipy.ndimage.map_coordinates(nominal.height_nm, places, order=1, cval=np.nan)
    return surface.with_height(surface.height_nm - wanted)
