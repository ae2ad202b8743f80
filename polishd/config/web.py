"""``[web]``: where the page and the HTTP API of a cell are served (docs/web.md)."""

from __future__ import annotations

import ipaddress
from typing import Annotated, Self

from pydantic import BeforeValidator, Field, model_validator

from polishd.config.physics import PartDocument
from polishd.config.plant import OpcUaSection
from polishd.config.shop_link import ShopLinkSection
from polishd.config.values import ConfigSection, Text, as_tuple


class WebSection(ConfigSection):
    """Where `polishd web` serves the cell's page and HTTP API. Left out: for this computer only."""

    address: Text = "127.0.0.1"
    """The address that it listens at. Beyond this computer only with `cert`, `key` and users."""
    port: Annotated[int, Field(ge=0, le=65535)] = 8750
    """Its port; 0: any that is free, which it says at its start. [1]"""
    cert: Text | None = None
    """File of its TLS certificate, with those between, PEM."""
    key: Text | None = None
    """File of that certificate's key, PEM; only its owner may read it."""
    hosts: Annotated[tuple[Text, ...], BeforeValidator(as_tuple)] = ()
    """Names by which browsers may ask for it, beside `localhost` and `address`: any other is refused."""
    users: Text | None = None
    """File of its users, with hashes of their tokens; left out: `web-users.json` in `cell.state_dir`."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.cert is None) != (self.key is None):
            raise ValueError("cert: goes with key; name both files, or none")
        if not self.loopback and self.cert is None:
            raise ValueError("address: beyond this computer only by TLS; name cert and key, or use 127.0.0.1")
        return self

    @property
    def loopback(self) -> bool:
        """It is reached from this computer only."""
        try:
            return ipaddress.ip_address(self.address).is_loopback
        except ValueError:
            return self.address == "localhost"


class CellWebSection(WebSection):
    """Where `polishd web` serves the cell's page and HTTP API. Left out: for this computer only."""

    metrics: bool = False
    """Answer `GET /metrics` with figures for Prometheus, to whoever has a token (docs/plant-systems.md). Needs
    polishd[metrics]."""


class ServedDocument(PartDocument):
    """A cell's file, as far as it says who watches the cell, and which shop it belongs to."""

    web: CellWebSection = CellWebSection()
    shop: ShopLinkSection | None = None
    opcua: OpcUaSection | None = None
