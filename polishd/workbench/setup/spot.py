"""A removal spot that was measured, for a new cell: two maps, an ``.npz``, or an array."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from polishd.config.cell import CellConfig
from polishd.config.tables import read_tif, tif_bytes
from polishd.model.errors import ConfigError
from polishd.model.process import MeasuredTif
from polishd.process.measured_tif import preston_from_tif
from polishd.workbench.calibration.verbs import SpotPlace, tif_of_maps
from polishd.workbench.maps.files import MapSource
from polishd.workbench.setup.answers import SpotKeys
from polishd.workbench.setup.draft import CellDraft

SPOT = "spot.npz"


def add_spot(draft: CellDraft, given: SpotKeys, config: CellConfig) -> None:
    """The measured TIF beside the cell, which names it and the Preston constant that goes with it."""
    tif = _tif(given, draft.answers.folder)
    preston = preston_from_tif(config.tool_process(), tif.depth_ratio, tif)
    draft.raw["process"] |= {"removal_model": "measured_tif", "tif": SPOT, "preston": f"{preston:.5g} cm2/N"}
    draft.files[SPOT] = tif_bytes(tif)
    draft.assumed.pop("process.preston", None)


def _tif(given: SpotKeys, folder: Path) -> MeasuredTif:
    if given.file is None:
        maps = (folder / str(given.before), folder / str(given.after))
        place = SpotPlace(given.depth_ratio, given.azimuth_deg, None)
        return tif_of_maps(MapSource.of(), maps, given.seconds or 0.0, place)[0]
    path = folder / Path(given.file).expanduser()
    if path.suffix == ".npz":
        return read_tif(path)
    rate = _array(path)
    return MeasuredTif(rate, given.pitch_mm or 0.0, given.azimuth_deg, given.depth_ratio)


def _array(path: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """(ny, nx) nm/s; ConfigError where the file holds no such array."""
    try:
        content = path.read_bytes()
        if path.suffix == ".npy":
            rate = np.load(io.BytesIO(content), allow_pickle=False)
        else:
            rate = np.loadtxt(io.StringIO(content.decode()), delimiter="," if b"," in content else None, ndmin=2)
    except (OSError, ValueError, EOFError) as error:
        raise ConfigError(f"{path}: is no array of a spot ({error}); give rows of nm/s, row 0 the top") from error
    found = np.asarray(rate, dtype=np.float64) if rate.dtype.kind in "fiu" else np.zeros(0)
    if found.ndim != 2 or not np.isfinite(found).all() or not found.sum() > 0:
        raise ConfigError(f"{path}: must be a table of finite rates, nm/s, that remove something; mend it")
    return found
