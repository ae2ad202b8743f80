"""The profiles that polishd brings, by name, and those of the user's own, by file."""

from __future__ import annotations

from pathlib import Path

from polishd.api import ConfigError
from polishd.config.device_file import load_device_profile
from polishd.config.device_profile import DeviceProfile
from polishd.config.places import did_you_mean, join_words

DEVICE_PROFILE_DIR = Path(__file__).with_name("profiles")


def shipped() -> list[str]:
    """Names, in order."""
    return sorted(path.stem for path in DEVICE_PROFILE_DIR.glob("*.toml"))


def profile_of(name: str, base_dir: Path) -> DeviceProfile:
    """The profile of a name, or in a file (``.toml``) in ``base_dir``; ConfigError says what is wrong, and where."""
    if name.endswith(".toml"):
        return load_device_profile(base_dir / Path(name).expanduser())
    known = shipped()
    if name not in known:
        hint = (
            f"{did_you_mean(name, known)} polishd has {join_words(known)}; a profile of your own is a file, NAME.toml"
        )
        raise ConfigError(f"profile {name!r} is not known{hint}")
    return load_device_profile(DEVICE_PROFILE_DIR / f"{name}.toml")
