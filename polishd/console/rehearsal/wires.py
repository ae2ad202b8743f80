"""A simulated device's address: of the same kind as the cell's, on this computer."""

from __future__ import annotations

from urllib.parse import urlsplit

from polishd.console.demo_files import free_port
from polishd.console.rehearsal.draft import LOOPBACK, SIM_STATE, RehearsalDraft
from polishd.drivers.transport.address import SerialLine, SlcanAddress, SocketcandAddress, Tcp, parse_address


def wire(
    draft: RehearsalDraft, device: str, port_name: str, address: str
) -> Tcp | SerialLine | SlcanAddress | SocketcandAddress:
    """Lay the simulated device's address over the cell's; the cell's own, read. ConfigError where it is none."""
    real = parse_address(address, draft.config.base_dir)
    query = urlsplit(address).query
    if isinstance(real, SerialLine | SlcanAddress):
        scheme = address.partition(":")[0]
        draft.laid[f"{device}.address"] = f"{scheme}:{SIM_STATE}/{port_name}" + (f"?{query}" if query else "")
        return real
    port = free_port()
    draft.put(port_name, "port", port, "free on this computer")
    at = f"{LOOPBACK}:{port}"
    draft.laid[f"{device}.address"] = f"tcp://{at}" if isinstance(real, Tcp) else f"socketcand://{at}/{real.channel}"
    return real
