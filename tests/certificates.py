"""Issue TLS certificates for tests from a private authority, with any validity."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

DAY_S = 86400.0


def _name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


class Authority:
    """Certificate authority; ``write`` writes its certificate to the path that clients are configured with."""

    def __init__(self, name: str = "house") -> None:
        self._name, self._key = _name(name), ec.generate_private_key(ec.SECP256R1())
        now = datetime.now(UTC)
        self._own = (
            self._builder(self._name, self._key.public_key(), now - timedelta(days=400), now + timedelta(days=4000))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(self._key.public_key()), critical=False)
            .sign(self._key, hashes.SHA256())
        )

    def write(self, path: Path) -> None:
        """Write the certificate of the authority."""
        path.write_bytes(self._own.public_bytes(serialization.Encoding.PEM))

    def certify(
        self, folder: Path, valid_s: float = 90 * DAY_S, hosts: Sequence[str] = ("127.0.0.1",), name: str = "office"
    ) -> int:
        """Write ``cert.pem`` and ``key.pem`` of a server, as a renewal does, and return the serial number."""
        key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
        names = [x509.IPAddress(ipaddress.ip_address(host)) for host in hosts]
        found = (
            self._builder(_name(name), key.public_key(), now - timedelta(days=300), now + timedelta(seconds=valid_s))
            .add_extension(x509.SubjectAlternativeName(names), critical=False)
            .sign(self._key, hashes.SHA256())
        )
        pem, kind = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
        for file, content in (
            ("key.pem", key.private_bytes(pem, kind, serialization.NoEncryption())),
            ("cert.pem", found.public_bytes(pem)),
        ):
            fresh = folder / f"{file}.new"
            fresh.write_bytes(content)
            fresh.chmod(0o600)
            fresh.replace(folder / file)
        return found.serial_number

    def _builder(
        self, name: x509.Name, key: ec.EllipticCurvePublicKey, begins: datetime, ends: datetime
    ) -> x509.CertificateBuilder:
        return (
            x509.CertificateBuilder()
            .subject_name(name)
            .issuer_name(self._name)
            .public_key(key)
            .serial_number(x509.random_serial_number())
            .not_valid_before(begins)
            .not_valid_after(ends)
        )
