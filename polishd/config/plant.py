"""``[opcua]``: how a cell presents itself to systems of the plant over OPC UA (docs/plant-systems.md)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from polishd.config.values import ConfigSection, Text


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
