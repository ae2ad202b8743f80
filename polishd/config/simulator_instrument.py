"""The section of SIM.toml that says what the interferometer adds to the part's true heights: all off by default."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from polishd.config.values import ConfigSection, NotNegative, ShareOrNone


class InstrumentErrors(ConfigSection):
    """What is in every map and not in the part. Sizes in nm are RMS over the circle about the part."""

    tilt_nm: NotNegative = 0.0
    """Most tilt by which the part is set up anew for each map, along x and along y."""
    power_nm: float = 0.0
    """Power of its reference."""
    astigmatism_nm: NotNegative = 0.0
    """Astigmatism of its reference, ..."""
    astigmatism_deg: float = 20.0
    """... high along this direction."""
    coma_nm: NotNegative = 0.0
    """Coma of its reference, along x."""
    mount_nm: NotNegative = 0.0
    """Print-through of three points of the mount: a trefoil, ..."""
    mount_turns: bool = False
    """... which turns with the part, or stays with the instrument."""
    mount_anew: bool = False
    """... whose points press otherwise with each set-up: size and direction are drawn anew for each map, `mount_nm` is
    their RMS, and nothing turns."""
    magnification: Annotated[float, Field(gt=-0.1, lt=0.1)] = 0.0
    """By how much more the part is magnified than the instrument says. [1]"""
    distortion: Annotated[float, Field(gt=-0.1, lt=0.1)] = 0.0
    """By how much more at the part's rim than in its middle; between them with the square of the radius. [1]"""
    retrace_nm_per_urad: float = 0.0
    """What a slope along x adds, where the beam does not come back the way it went. [nm/urad]"""
    slope_noise_nm_per_urad: NotNegative = 0.0
    """Noise of a sample by the slope there, beside `truth.map_noise_nm`. [nm/urad]"""
    dead_pixels: ShareOrNone = 0.0
    """Share of the samples that never have data. [1]"""
