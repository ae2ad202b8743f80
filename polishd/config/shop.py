"""A shop's own file: who it is, where it keeps its database, and where it is served (docs/shop.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from polishd.config.document import TomlDocument, load_toml
from polishd.config.values import ConfigSection, Name, Text
from polishd.config.web import WebSection


class ShopSection(ConfigSection):
    """Who this shop is, and where it keeps what it knows."""

    name: Name
    """The shop's name."""
    state_dir: Text
    """Folder of its database and of the hashes of tokens; one shop per folder."""


class ShopWebSection(WebSection):
    """Where `polishd shop serve` serves the shop's API. Left out: for this computer only."""

    port: Annotated[int, Field(ge=0, le=65535)] = 8760
    """Its port; 0: any that is free, which it says at its start. [1]"""
    users: Text | None = None
    """File of its people, with hashes of their tokens; left out: `shop-users.json` in `shop.state_dir`."""


class ShopFile(TomlDocument):
    """All of a shop's file."""

    shop: ShopSection
    web: ShopWebSection = ShopWebSection()

    @property
    def state_dir(self) -> Path:
        """Its database, and hashes of tokens."""
        return self.resolve(self.shop.state_dir)


def load_shop(path: Path) -> ShopFile:
    """ConfigError, a line each: ``FILE:LINE: section.key: what is wrong; what to do``."""
    return ShopFile.of(*load_toml(path))
