"""Sections of servers: the web page and HTTP API (docs/how-to/web.md), OPC UA, and the shop."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from polishd.config.fields import ConfigSection, Name, Text, as_tuple
from polishd.config.process_sections import PartDocument
from polishd.config.toml_loader import TomlDocument, load_toml
from polishd.util.files import SecretPlace

# ``[opcua]``: identification of a cell to plant systems over OPC UA (docs/how-to/plant-systems.md).


class OpcUaSection(ConfigSection):
    """Server `polishd opcua` for clients on this computer. Left out: there is no such server."""

    port: Annotated[int, Field(ge=0, le=65535)] = 4840
    """Port at 127.0.0.1. 0: any free port, which the server prints at its start. [1]"""
    manufacturer: Text
    """Manufacturer of the machine."""
    serial_number: Text
    """The machine's serial number, from its manufacturer."""
    product_instance_uri: Text
    """The machine's globally unique identifier from its manufacturer: `urn:` or `http://`."""
    model: Text | None = None
    """The machine's model."""
    location: Text | None = None
    """The machine's location."""


CERTIFICATE_WARNING_S = 21 * 86400.0
"""Lead time of the warning before a TLS certificate expires."""

# ``[shop]`` of a cell's file: the shop that the cell belongs to (docs/how-to/shop.md).

LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})


def _address(url: str) -> str:
    """Check a shop's address: a token is sent unencrypted only on this computer."""
    try:
        parts = urlsplit(url)
        whole = parts.scheme in {"http", "https"} and parts.hostname and parts.port != 0
    except ValueError:
        raise ValueError(f"{url!r} is not a URL; write it as https://shop.example:8760") from None
    if not whole or parts.username or parts.path.strip("/") or parts.query or parts.fragment:
        raise ValueError(f"{url!r} is not the address of a shop; write it as https://shop.example:8760")
    if parts.scheme == "http" and parts.hostname not in LOOPBACK:
        raise ValueError("another computer needs TLS; write it with https://")
    return url


class ShopLinkSection(ConfigSection):
    """The shop of this cell. `polishd shop connect` reports events to it, and requests parts from it."""

    url: Annotated[Text, AfterValidator(_address)]
    """Its address: `https://HOST:PORT`; `http://` on this computer only."""
    token: SecretPlace
    """Location of this cell's token, `file:NAME` or `env:VARIABLE`. `polishd shop serve --add-cell NAME` makes it; NAME
    is this cell's name in the shop."""
    ca_file: Text | None = None
    """Trusted CA certificates instead of the system's, PEM, for a shop with a private CA."""
    max_assigned: Annotated[int, Field(ge=0, le=100)] = 1
    """Number of the shop's parts in this cell's queue, up to which it requests more. 0: it requests none. [1]"""
    every_s: Annotated[float, Field(ge=0.1, le=600)] = 2.0
    """Period of reports and requests."""


class WebSection(ConfigSection):
    """Address of the cell's page and HTTP API, `polishd web`. Left out: for this computer only."""

    address: Text = "127.0.0.1"
    """Address of the server. An address for other computers needs `cert`, `key` and users."""
    port: Annotated[int, Field(ge=0, le=65535)] = 8750
    """Port. 0: any free port, which the server prints at its start. [1]"""
    cert: Text | None = None
    """File of its TLS certificate with intermediate certificates, PEM."""
    key: Text | None = None
    """File of that certificate's key, PEM. Only its owner may have read access."""
    hosts: Annotated[tuple[Text, ...], BeforeValidator(as_tuple)] = ()
    """Host names accepted from browsers, in addition to `localhost` and `address`. Any other is refused."""
    users: Text | None = None
    """File of its users, with hashes of their tokens. Left out: `web-users.json` in `cell.state_dir`."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.cert is None) != (self.key is None):
            raise ValueError("cert: needs key, and key needs cert; name both files, or none")
        if not self.loopback and self.cert is None:
            raise ValueError("address: another computer needs TLS; name cert and key, or use 127.0.0.1")
        return self

    @property
    def loopback(self) -> bool:
        """True if only this computer can reach it."""
        try:
            return ipaddress.ip_address(self.address).is_loopback
        except ValueError:
            return self.address == "localhost"


class CellWebSection(WebSection):
    """Address of the cell's page and HTTP API, `polishd web`. Left out: for this computer only."""

    metrics: bool = False
    """Answer `GET /metrics` with figures for Prometheus, to users with a token (docs/how-to/plant-systems.md). Needs
    polishd[metrics]."""


class ServedDocument(PartDocument):
    """A cell's file with its servers and its shop."""

    web: CellWebSection = CellWebSection()
    shop: ShopLinkSection | None = None
    opcua: OpcUaSection | None = None


# A shop's file (docs/how-to/shop.md).


class ShopSection(ConfigSection):
    """The shop's name, and the folder of its state."""

    name: Name
    """The shop's name."""
    state_dir: Text
    """Folder of its database and of the hashes of tokens; one shop per folder."""


class ShopWebSection(WebSection):
    """Address of the shop's API, `polishd shop serve`. Left out: for this computer only."""

    port: Annotated[int, Field(ge=0, le=65535)] = 8760
    """Port. 0: any free port, which the server prints at its start. [1]"""
    users: Text | None = None
    """File of its users, with hashes of their tokens. Left out: `shop-users.json` in `shop.state_dir`."""


class ShopFile(TomlDocument):
    """A shop's file."""

    shop: ShopSection
    web: ShopWebSection = ShopWebSection()

    @property
    def state_dir(self) -> Path:
        """Folder of its database and of the hashes of tokens."""
        return self.resolve(self.shop.state_dir)


def load_shop(path: Path) -> ShopFile:
    """Read a shop's file.

    Raises ConfigError, one line per problem: ``FILE:LINE: section.key: what is wrong; what to do``.
    """
    return ShopFile.of(*load_toml(path))
