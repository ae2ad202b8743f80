"""What one map of an instrument tells: the beginning of its profile, and of the part."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polishd.model.errors import BadMap
from polishd.model.surface import SurfaceMap
from polishd.plain import toml
from polishd.workbench.maps.files import MapSource

TEMPLATE = """\
# The profile of an instrument: docs/instruments.md. All keys: docs/reference/profile.md
# Any value that is changed makes the record of `polishd map commission` void.
name = {name}
{says}
[orientation]                        # arrays are flipped left-right where mirror, then turned counter-clockwise:
mirror = false                       # the part as the tool sees it, x right, y up
rotation_deg = 0                     # 0, 90, 180, 270

[height]
sign = 1                             # -1 where high is negative
factor = 1.0                         # 0.5 where its files give wavefronts in reflection as they are
{unit}
[registration]
by = "none"                          # the centre of the array is the part's; or aperture, fiducials, both

# [artefact]                         # LOOK: what proves all this: bumps in no symmetric arrangement, as the tool
# name = "three bumps"               # sees them; here those of an example
# bumps = [
#   {{ x_mm = 20.0, y_mm = 12.0, sigma_x_mm = 9.0, sigma_y_mm = 5.0, height_nm = 120.0 }},
#   {{ x_mm = -14.0, y_mm = 24.0, sigma_x_mm = 4.0, sigma_y_mm = 4.0, height_nm = 80.0 }},
#   {{ x_mm = -8.0, y_mm = -22.0, sigma_x_mm = 5.0, sigma_y_mm = 5.0, height_nm = -60.0 }},
# ]
"""
UNIT = "# unit_nm = 1.0                      # LOOK: its files name no unit; nanometres per unit\n"


@dataclass(frozen=True, slots=True)
class Sample:
    """A map of the instrument."""

    name: str
    surface: SurfaceMap
    aperture_mm: float
    """Diameter of the round part that it shows."""

    @property
    def part_id(self) -> str:
        """The part's name in it; empty where it has none."""
        return self.surface.part_id


def read_sample(path: Path) -> Sample:
    """The map; BadMap where no reader knows it, or where it has no lateral scale to tell a size by."""
    surface = MapSource.of().read(path)
    if surface.pitch_mm is None:
        raise BadMap(f"{path}: has no lateral scale; name another sample, or none, and mend the profile by hand")
    return Sample(path.name, surface, aperture_mm(surface, surface.pitch_mm))


def aperture_mm(surface: SurfaceMap, pitch_mm: float) -> float:
    """Diameter, mm, of the round part that a map shows, centred in its frame."""
    rows, columns = np.nonzero(surface.valid)
    if not rows.size:
        raise BadMap(f"{surface.path}: has no data; name another map")
    extent = (min(np.ptp(rows), np.ptp(columns)) + 1) * pitch_mm
    return math.floor(float(extent))


def profile_text(sample: Sample | None) -> str:
    """The instrument's profile as far as one map tells it; what a person has to say stands there as comments."""
    if sample is None:
        return TEMPLATE.format(name=toml("interferometer"), says="", unit="")
    surface = sample.surface
    says = [f"# Begun from {sample.name}, {surface.format}.", *(f"# It says: {text}" for text in surface.warnings)]
    if surface.instrument:
        says.append(f"# serials = [{toml(surface.instrument)}]  # a word of that: maps of any other are refused")
    if open_ := sorted(surface.unsaid & {"surface", "orientation"}):
        says.append(f"# gives = {toml(open_)}  # LOOK: its files do not say that; make it true below, take # off")
    name = toml(surface.instrument or "interferometer")
    unit = UNIT if "unit" in surface.unsaid else ""
    return TEMPLATE.format(name=name, says="\n".join(says) + "\n", unit=unit)
