"""Seal of a certificate: SHA-256 and signature over the canonical bytes of its JSON, and their verification."""

from __future__ import annotations

import base64
import binascii
import contextlib
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from pydantic import ValidationError

from polishd.model.errors import ConfigError
from polishd.reports.certificate.model import SCHEMA, PartCertificate, Seal, Signature
from polishd.util.files import read_input, require_private, write_atomic

ID_DIGITS = 16
SEAL = "seal"
PUBLIC = ".pub"
"""Suffix of the public key's file beside the private key."""
_PEM = serialization.Encoding.PEM


def canonical(content: Mapping[str, Any]) -> bytes:
    """Return the bytes that are hashed and signed: all but the seal, sorted, no blanks, UTF-8, shortest numbers."""
    sealed_content = {key: value for key, value in content.items() if key != SEAL}
    return json.dumps(
        sealed_content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    ).encode()


def written(content: Mapping[str, Any]) -> bytes:
    """Return the bytes of the JSON file. Another layout of the same content is a changed file."""
    return (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def sealed(content: Mapping[str, Any], key: Ed25519PrivateKey | None) -> Seal:
    """Return the seal of a content; without a key it has no signature."""
    signed = canonical(content)
    signature = None
    if key is not None:
        public = key.public_key()
        signature = Signature(
            algorithm="Ed25519",
            key=_text(public.public_bytes_raw()),
            key_id=key_id(public),
            value=_text(key.sign(signed)),
        )
    return Seal(sha256=hashlib.sha256(signed).hexdigest(), signature=signature)


def holds(signature: Signature, content: Mapping[str, Any]) -> bool:
    """True if the signature is that of its key over this content."""
    try:
        public = public_of(signature)
        public.verify(base64.b64decode(signature.value, validate=True), canonical(content))
    except (InvalidSignature, ValueError, binascii.Error):
        return False
    return signature.key_id == key_id(public)


def public_of(signature: Signature) -> Ed25519PublicKey:
    """Return the public key of a signature; ValueError if it is not one."""
    return Ed25519PublicKey.from_public_bytes(base64.b64decode(signature.key, validate=True))


def key_id(public: Ed25519PublicKey) -> str:
    """Return the id of a key."""
    return hashlib.sha256(public.public_bytes_raw()).hexdigest()[:ID_DIGITS]


def make_key(path: Path) -> str:
    """Write a new key pair, the private file readable by its owner only; return the id.

    Raises:
        ConfigError: a file exists, or cannot be written. No file is written then.
    """
    public_path = path.with_name(path.name + PUBLIC)
    for one in (path, public_path):
        if one.exists():
            raise ConfigError(f"{one}: exists, and a key is never overwritten. Name another file.")
    key = Ed25519PrivateKey.generate()
    public = key.public_key().public_bytes(_PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    private = key.private_bytes(_PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    try:
        write_atomic(public_path, public)
        write_atomic(path, private, mode=0o600)
    except OSError as error:
        with contextlib.suppress(OSError):  # a read-only disk refuses that, too
            public_path.unlink(missing_ok=True)
        raise ConfigError(
            f"{path}: cannot be written: {error.strerror}. Name a file in a folder that exists."
        ) from error
    return key_id(key.public_key())


def private_key(path: Path) -> Ed25519PrivateKey:
    """Read the shop's private key; ConfigError if it cannot be read, others can read it, or it is not a key."""
    content = _read_bytes(path)
    require_private(path, "the shop's key: ")
    try:
        key = serialization.load_pem_private_key(content, password=None)
    except TypeError:
        raise ConfigError(f"{path}: the key has a passphrase. Use a key without one.") from None
    except (ValueError, UnsupportedAlgorithm):
        _refuse_key(path, "private")
    return key if isinstance(key, Ed25519PrivateKey) else _refuse_key(path, "private")


def public_key(path: Path) -> Ed25519PublicKey:
    """Read a public key; ConfigError if it cannot be read, or is not one."""
    try:
        key = serialization.load_pem_public_key(_read_bytes(path))
    except (ValueError, UnsupportedAlgorithm):
        _refuse_key(path, "public")
    return key if isinstance(key, Ed25519PublicKey) else _refuse_key(path, "public")


def _refuse_key(path: Path, kind: str) -> NoReturn:
    other = f" The name of a public key ends in {PUBLIC}." if kind == "public" else ""
    raise ConfigError(f"{path}: not a {kind} Ed25519 key in PEM. Make a pair with polishd certificate keygen.{other}")


def _read_bytes(path: Path) -> bytes:
    try:
        return read_input(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}. Name the file of the key.") from error


def _text(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")


# Verification: a finding for the content, the signature and the PDF.

JSON, PDF = ".json", ".pdf"
REQUEST_AGAIN = "Request the certificate from the shop again."


@dataclass(frozen=True, slots=True)
class VerificationFinding:
    """Result of one check."""

    about: str
    """``content``, ``signature`` or ``pdf``."""
    right: bool | None
    """None: neither wrong nor proved."""
    words: str


@dataclass(frozen=True, slots=True)
class Verified:
    """Result of a verification."""

    number: str
    findings: tuple[VerificationFinding, ...]
    signer: str
    """Id of the given key if it signed the certificate; else empty."""

    @property
    def right(self) -> bool:
        """True if no check failed."""
        return all(one.right is not False for one in self.findings)


def verify(path: Path, key: Ed25519PublicKey | None) -> Verified:
    """Verify a certificate, named by its PDF or its JSON file.

    Args:
        path: one of the two files; the other is expected beside it.
        key: public key of the shop, received in another way than the certificate; None: not available.

    Raises:
        ConfigError: the JSON file is missing, or is not a certificate.
    """
    json_path = path.with_suffix(JSON) if path.suffix.lower() == PDF else path
    content = _read_certificate(json_path, path)
    raw, certificate = _parsed(json_path, content)
    signed_by = "" if key is None or certificate.seal.signature is None else certificate.seal.signature.key_id
    findings = (
        *_content(json_path, content, raw, certificate),
        *_signature(raw, certificate, key),
        _pdf(path, json_path, certificate),
    )
    proved = all(one.right for one in findings if one.about != "pdf")
    return Verified(certificate.number, findings, signed_by if proved else "")


def _read_certificate(json_path: Path, path: Path) -> bytes:
    try:
        return read_input(json_path)
    except OSError as error:
        action = "Name a certificate."
        if json_path != path:
            action = f"Put the JSON file of the same name beside {path.name}: a PDF is verified by it."
        raise ConfigError(f"{json_path}: cannot be read: {error.strerror}. {action}") from error


def _parsed(path: Path, content: bytes) -> tuple[dict[str, Any], PartCertificate]:
    try:
        raw = json.loads(content, parse_constant=_refused)
        if not isinstance(raw, dict) or raw.get("schema") != SCHEMA:
            raise ConfigError(f"{path}: not a certificate with the schema {SCHEMA}. Name a certificate.")
        return raw, PartCertificate.model_validate(raw)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise ConfigError(f"{path}: not a complete certificate: {key}: {first['msg']}. {REQUEST_AGAIN}") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not JSON ({error}): changed or cut off. {REQUEST_AGAIN}") from None


def _refused(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number")


def _content(
    path: Path, content: bytes, raw: dict[str, Any], certificate: PartCertificate
) -> Iterator[VerificationFinding]:
    try:
        signed = canonical(raw)
        same_layout = written(raw) == content
    except ValueError:  # a lone surrogate, which no certificate has
        signed, same_layout = b"", False
    if hashlib.sha256(signed).hexdigest() != certificate.seal.sha256:
        yield VerificationFinding("content", False, f"{path.name} was changed: its checksum is wrong. {REQUEST_AGAIN}")
    elif not same_layout:
        yield VerificationFinding("content", False, f"{path.name} was rewritten with the same content. {REQUEST_AGAIN}")
    else:
        yield VerificationFinding("content", True, f"{path.name} is unchanged: its checksum is right.")


def _signature(
    raw: dict[str, Any], certificate: PartCertificate, key: Ed25519PublicKey | None
) -> Iterator[VerificationFinding]:
    signature = certificate.seal.signature
    if signature is None:
        words = "Not signed: the checksum finds an accidental change, but cannot prove the author."
        yield VerificationFinding("signature", None if key is None else False, words)
        return
    try:
        good = holds(signature, raw)
    except ValueError:
        good = False
    if not good:
        words = f"The signature is wrong: the signature or the content was changed. {REQUEST_AGAIN}"
        yield VerificationFinding("signature", False, words)
    elif key is None:
        words = f"Unchanged, signed with the key {signature.key_id}, whose owner is not known. "
        yield VerificationFinding("signature", True, words + "Name the public key of the shop with --key.")
    elif key_id(key) != signature.key_id:
        words = f"Signed with the key {signature.key_id}, not with the given key {key_id(key)}."
        yield VerificationFinding("signature", False, words)
    else:
        yield VerificationFinding("signature", True, f"Signed with the given key {signature.key_id}, and unchanged.")


def _pdf(named: Path, json_path: Path, certificate: PartCertificate) -> VerificationFinding:
    """Check the PDF that was named, or the one that the JSON file names beside it."""
    path = named if named != json_path else json_path.with_name(Path(certificate.pdf.name).name)
    try:
        content = read_input(path)
    except OSError as error:
        right = None if named == json_path else False
        return VerificationFinding("pdf", right, f"{path.name} was not checked: {error.strerror}.")
    if hashlib.sha256(content).hexdigest() == certificate.pdf.sha256:
        return VerificationFinding("pdf", True, f"{path.name} is the PDF of this certificate, unchanged.")
    return VerificationFinding(
        "pdf", False, f"{path.name} was changed, or is the PDF of another certificate. {REQUEST_AGAIN}"
    )
