"""``[web]``: where the page and the HTTP API of a cell are served (docs/web.md)."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from polishd.config.fields import ConfigSection, Name, Text, as_tuple
from polishd.config.process_sections import PartDocument
from polishd.config.toml_loader import TomlDocument, load_toml
from polishd.util.secret_files import SecretPlace

# ``[opcua]``: how a cell presents itself to systems of the plant over OPC UA (docs/plant-systems.md).


class OpcUaSection(ConfigSection):
    """What `polishd opcua` says of this machine, to clients on this computer. Left out: there is no such server."""

    port: Annotated[int, Field(ge=0, le=65535)] = 4840
    """Its port at 127.0.0.1; 0: any that is free, which it says at its start. [1]"""
    manufacturer: Text
    """Who built the machine."""
    serial_number: Text
    """The machine's, by its manufacturer."""
    product_instance_uri: Text
    """The machine's, unlike that of any other in the world: `urn:` or `http://`, by its manufacturer."""
    model: Text | None = None
    """The machine's model."""
    location: Text | None = None
    """Where it stands."""


# ``[shop]`` of a cell's file: the shop that the cell belongs to (docs/shop.md).

LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})


def _address(url: str) -> str:
    """A token never goes in the clear beyond this computer."""
    try:
        parts = urlsplit(url)
        whole = parts.scheme in {"http", "https"} and parts.hostname and parts.port != 0
    except ValueError:
        raise ValueError(f"{url!r} is no URL; write it as https://shop.example:8760") from None
    if not whole or parts.username or parts.path.strip("/") or parts.query or parts.fragment:
        raise ValueError(f"{url!r} is no address of a shop; write it as https://shop.example:8760")
    if parts.scheme == "http" and parts.hostname not in LOOPBACK:
        raise ValueError("beyond this computer only by TLS; write it with https://")
    return url


class ShopLinkSection(ConfigSection):
    """The shop that this cell belongs to; `polishd shop connect` tells it what happens here, and asks it for parts."""

    url: Annotated[Text, AfterValidator(_address)]
    """Its address: `https://HOST:PORT`; `http://` on this computer only."""
    token: SecretPlace
    """Where this cell's token is kept, `file:NAME` or `env:VARIABLE`: `polishd shop serve --add-cell` makes it. The
    name for which it was made is this cell's at the shop."""
    ca_file: Text | None = None
    """Certificates to trust instead of the system's, PEM: of a shop of the house."""
    max_assigned: Annotated[int, Field(ge=0, le=100)] = 1
    """So many of the shop's parts are asked for until they wait in this cell's queue; 0: it asks for none. [1]"""
    every_s: Annotated[float, Field(ge=0.1, le=600)] = 2.0
    """How often it is told, and asked."""


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


# A shop's own file: who it is, where it keeps its database, and where it is served (docs/shop.md).


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
