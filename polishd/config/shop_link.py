"""``[shop]`` of a cell's file: the shop that the cell belongs to (docs/shop.md)."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

from polishd.config.values import ConfigSection, Text
from polishd.secret import SecretPlace

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
    """The shop that this cell belongs to; `polishd shop link` tells it what happens here, and asks it for parts."""

    url: Annotated[Text, AfterValidator(_address)]
    """Its address: `https://HOST:PORT`; `http://` on this computer only."""
    token: SecretPlace
    """Where this cell's token is kept, `file:NAME` or `env:VARIABLE`: `polishd shop serve --add-cell` makes it. The
    name for which it was made is this cell's at the shop."""
    ca_file: Text | None = None
    """Certificates to trust instead of the system's, PEM: of a shop of the house."""
    ahead: Annotated[int, Field(ge=0, le=100)] = 1
    """So many of the shop's parts are asked for until they wait in this cell's queue; 0: it asks for none. [1]"""
    every_s: Annotated[float, Field(ge=0.1, le=600)] = 2.0
    """How often it is told, and asked."""
