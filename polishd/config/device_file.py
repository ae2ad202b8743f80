"""A device profile's file: read, and judged by what its tables must say together."""

from __future__ import annotations

from pathlib import Path

from polishd.config.device_checks import faults_of
from polishd.config.device_profile import DeviceProfile
from polishd.config.document import loads_toml
from polishd.files import toml_text
from polishd.model.errors import ConfigError


def load_device_profile(path: Path) -> DeviceProfile:
    """Read a profile; ConfigError with one line per problem: ``FILE:LINE: table.key: what is wrong; what to do``."""
    return device_profile_of(toml_text(path), path)


def device_profile_of(text: str, path: Path) -> DeviceProfile:
    """The same of a text that stood in that file."""
    profile = DeviceProfile.of(*loads_toml(text, path))
    if found := faults_of(profile):
        raise ConfigError("\n".join(profile.source.error(key, problem) for key, problem in found))
    return profile
