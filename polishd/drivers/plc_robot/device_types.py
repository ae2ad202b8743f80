"""Device type ``plc_robot``: a robot whose controller loads a file and is commanded by its variables."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

from polishd.api import ConfigError, DeviceContext, DeviceType, OwnLines, read_secret
from polishd.config.controller_profile import ControllerProfile, load_controller_profile
from polishd.config.fields import ConfigSection
from polishd.drivers.plc_robot.driver import PlcRobot
from polishd.drivers.plc_robot.opcua import OpcUa, OpcUaCertificates
from polishd.drivers.plc_robot.variables import Recorded, RecordedDelivery, Variables
from polishd.drivers.transport.address import Tcp, tcp_address
from polishd.drivers.transport.file_delivery import Delivery, Folder, Ftp, RemoteFolder, Sftp
from polishd.util.extras import require_extra
from polishd.util.files import SecretPlace, named_path, require_private

# The keys of ``[robot]`` with ``type = "plc_robot"``: docs/how-to/plc-robot.md.


AGAIN_LINKS = 2.0
"""Delays of the link after which a datagram without an answer counts as lost."""


class PlcRobotOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "plc_robot"``."""

    profile: str
    """The controller's profile: a shipped one by its name, or the path of a ``.toml``."""
    address: str
    """Address of its variables: ``opc.tcp://host:port`` for opcua, ``ads://host/NETID:PORT`` for ads, ``tcp://host:port``
    for modbus, ``hses://host:10040`` for hses."""
    delivery: str
    """Folder that it reads files from: ``folder:PATH``, ``ftp://user@host/PATH`` or ``sftp://user@host/PATH``."""
    controller_dir: str = ""
    """Path before the file's name in the load command, with its last ``/`` or ``\\``."""
    user: str = ""
    """User of the opcua login; empty: no login."""
    password: SecretPlace | None = None
    """Password of that user."""
    certificate: str = ""
    """polishd's certificate, PEM or DER, for signed and encrypted opcua (Basic256Sha256), with URI ``urn:polishd``."""
    private_key: str = ""
    """Private key of that certificate."""
    server_certificate: str = ""
    """Certificate of the controller; a server with another one is refused."""
    delivery_password: SecretPlace | None = None
    """Password of the user in ``delivery``."""
    known_hosts: str = "~/.ssh/known_hosts"
    """File with the host key for sftp; a host without a key is refused."""


# Build a closed robot from the options. Checks what they name and opens nothing.

_HSES = re.compile(r"hses://(?P<host>[^/:]+):(?P<port>\d{1,5})")
_ADS = re.compile(r"ads://(?P<host>[^/:]+)/(?P<netid>(?:\d{1,3}\.){5}\d{1,3}):(?P<port>\d{1,5})")


def build(options: PlcRobotOptions, context: DeviceContext) -> PlcRobot:
    """Build the robot. ConfigError if the controller must not polish, or a library is missing."""
    profile = load_controller_profile(options.profile, context.base_dir)
    profile.require_usable()
    make = _link(profile, options, context)
    delivery = RecordedDelivery(_delivery(options, context, renames=profile.program.renames), options.delivery)
    return PlcRobot(
        f"{profile.name} at {options.address}",
        profile,
        lambda: Recorded(make(), options.address, delivery),
        delivery,
        options.controller_dir,
    )


def own_lines(options: PlcRobotOptions, context: DeviceContext) -> OwnLines:
    """Return the pauses, dwells and program ends of the controller's profile."""
    table = load_controller_profile(options.profile, context.base_dir).program
    dwells = {seconds: table.dwell.format(seconds=seconds) for seconds in (0.25, 2.5)}
    return OwnLines(
        f"[program] of the controller profile {options.profile!r}", dwells, (table.pause, table.end), table.language
    )


def _link(profile: ControllerProfile, options: PlcRobotOptions, context: DeviceContext) -> Callable[[], Variables]:
    table, silence_s = profile.variables, profile.silence_s
    match profile.link:
        case "opcua":
            require_extra(f"profile {options.profile!r}", "opcua")
            if not options.address.startswith("opc.tcp://"):
                raise ConfigError(f"address {options.address!r}: opcua needs opc.tcp://host:port")
            password = read_secret(options.password, context.base_dir) if options.password is not None else ""
            papers = _papers(options, context.base_dir)
            return lambda: OpcUa(options.address, table, silence_s, options.user, password, papers=papers)
        case "ads":
            from polishd.drivers.plc_robot.ads import Ads

            require_extra(f"profile {options.profile!r}", "ads")
            host, netid, port = _ads_address(options.address)
            return lambda: Ads(host, netid, port, table, silence_s)
        case "modbus":
            from polishd.drivers.plc_robot.modbus import Modbus  # imports pymodbus, which is slow

            where = tcp_address(options.address, context.base_dir, "modbus")
            make = partial(Modbus, where, table, silence_s, unit=profile.modbus_unit, little=profile.order == "little")
            make()  # checks its addresses
            return make
        case "hses":
            from polishd.drivers.plc_robot.hses import Hses

            again_s = AGAIN_LINKS * profile.link_ms / 1e3
            make_hses = partial(Hses, _hses_address(options.address), table, silence_s, again_s)
            make_hses()  # checks its addresses
            return make_hses


def _papers(options: PlcRobotOptions, base_dir: Path) -> OpcUaCertificates | None:
    """Return all three files, or None if none is named."""
    names = {key: getattr(options, key) for key in ("certificate", "private_key", "server_certificate")}
    if not any(names.values()):
        return None
    for key, name in names.items():
        if not (name and named_path(base_dir, name).is_file()):
            said = f"{name!r} is not a file" if name else "is missing"
            raise ConfigError(f"{key} {said}; encrypted opcua needs {', '.join(names)} (docs/how-to/plc-robot.md)")
    require_private(named_path(base_dir, options.private_key), f"private_key {options.private_key!r}: ")
    return OpcUaCertificates(**{key: named_path(base_dir, name) for key, name in names.items()})


def _delivery(options: PlcRobotOptions, context: DeviceContext, *, renames: bool) -> Delivery:
    kind, _, rest = options.delivery.partition(":")
    match kind:
        case "folder" if rest:
            return Folder(named_path(context.base_dir, rest).absolute())
        case "ftp":
            require_extra(f"delivery {options.delivery!r}", "ftp")
            return Ftp(_place(options, context, 21), renames=renames)
        case "sftp":
            require_extra(f"delivery {options.delivery!r}", "sftp")
            known_hosts = named_path(context.base_dir, options.known_hosts)
            if not known_hosts.is_file():
                raise ConfigError(
                    f"known_hosts {options.known_hosts!r} is not a file. Get the host key with ssh-keyscan."
                )
            return Sftp(_place(options, context, 22), known_hosts)
        case _:
            raise ConfigError(
                f"delivery {options.delivery!r}: write folder:PATH, ftp://user@host/PATH or sftp://user@host/PATH"
            )


def _place(options: PlcRobotOptions, context: DeviceContext, port: int) -> RemoteFolder:
    url = urlsplit(options.delivery)
    if not url.hostname or not url.username or url.password is not None or url.query or url.fragment:
        raise ConfigError(
            f"delivery {options.delivery!r}: write {url.scheme}://user@host/PATH; its password is delivery_password"
        )
    password = read_secret(options.delivery_password, context.base_dir) if options.delivery_password else ""
    return RemoteFolder(url.hostname, url.port or port, url.username, password, url.path.removeprefix("/"))


def _hses_address(address: str) -> Tcp:
    """Return host and port of ``hses://host:10040``."""
    if (found := _HSES.fullmatch(address)) and 0 < int(found["port"]) < 65536:
        return Tcp(found["host"], int(found["port"]))
    raise ConfigError(f"address {address!r}: write hses://host:10040")


def _ads_address(address: str) -> tuple[str, str, int]:
    """Return host, net id and port of ``ads://host/1.2.3.4.1.1:851``."""
    found = _ADS.fullmatch(address)
    if found is None or not all(int(part) < 256 for part in found["netid"].split(".")) or int(found["port"]) > 65535:
        raise ConfigError(f"address {address!r}: write ads://host/NETID:PORT, for example ads://plc/5.1.2.3.1.1:851")
    return found["host"], found["netid"], int(found["port"])


DEVICE_TYPES = [
    DeviceType(
        "plc_robot",
        "robot",
        PlcRobotOptions,
        build,
        own_lines=own_lines,
        simulated_by="plc_robot",
        simulation_speed=8.0,
        usual_address="opc.tcp://robot-controller:4840",
    )
]
