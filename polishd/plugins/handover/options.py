"""The keys of ``[robot]`` with ``type = "handover"``: docs/handover.md."""

from __future__ import annotations

from polishd.config.values import ConfigSection
from polishd.secret import SecretPlace


class HandoverOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "handover"``."""

    profile: str
    """The controller's profile: a shipped one by its name, or the path of a ``.toml``."""
    address: str
    """Where its variables are: ``opc.tcp://host:port`` for opcua, ``ads://host/NETID:PORT`` for ads, ``tcp://host:port``
    for modbus."""
    delivery: str
    """Where it reads files from: ``folder:PATH``, ``ftp://user@host/PATH`` or ``sftp://user@host/PATH``."""
    controller_dir: str = ""
    """What stands before the file's name when it is told to load it, with its last ``/`` or ``\\``."""
    user: str = ""
    """Who logs in on opcua; empty: nobody."""
    password: SecretPlace | None = None
    """That user's."""
    certificate: str = ""
    """Ours, PEM or DER, for opcua that is signed and encrypted (Basic256Sha256); its URI is ``urn:polishd``."""
    private_key: str = ""
    """That certificate's."""
    server_certificate: str = ""
    """The controller's: a server with another one is not spoken to."""
    delivery_password: SecretPlace | None = None
    """That of the user in ``delivery``."""
    known_hosts: str = "~/.ssh/known_hosts"
    """The file with the host key that sftp is to find: a host without one is refused."""
