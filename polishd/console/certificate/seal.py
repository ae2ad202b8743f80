"""The seal of a certificate: the twin's canonical bytes, their hash, and the shop's signature over them."""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from polishd.console.certificate.model import Seal, Signature
from polishd.files import write_atomic
from polishd.model.errors import ConfigError
from polishd.secret import require_private

ID_DIGITS = 16
SEAL = "seal"
PUBLIC = ".pub"
"""What the public key's file is called beside the private one's."""
_PEM = serialization.Encoding.PEM


def canonical(twin: Mapping[str, Any]) -> bytes:
    """What is hashed and signed: all but the seal, keys sorted, no blanks, UTF-8, shortest numbers."""
    content = {key: value for key, value in twin.items() if key != SEAL}
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


def written(twin: Mapping[str, Any]) -> bytes:
    """The twin's file: any other layout of the same content is a changed file."""
    return (json.dumps(twin, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def sealed(content: Mapping[str, Any], key: Ed25519PrivateKey | None) -> Seal:
    """The seal over some content; without a key only its hash."""
    said = canonical(content)
    signature = None
    if key is not None:
        public = key.public_key()
        signature = Signature(
            algorithm="Ed25519",
            key=_text(public.public_bytes_raw()),
            key_id=key_id(public),
            value=_text(key.sign(said)),
        )
    return Seal(sha256=hashlib.sha256(said).hexdigest(), signature=signature)


def holds(signature: Signature, twin: Mapping[str, Any]) -> bool:
    """Whether the key that the signature names made it over this content."""
    try:
        public = public_of(signature)
        public.verify(base64.b64decode(signature.value, validate=True), canonical(twin))
    except (InvalidSignature, ValueError, binascii.Error):
        return False
    return signature.key_id == key_id(public)


def public_of(signature: Signature) -> Ed25519PublicKey:
    """The key that the signature names; ValueError where it is none."""
    return Ed25519PublicKey.from_public_bytes(base64.b64decode(signature.key, validate=True))


def key_id(public: Ed25519PublicKey) -> str:
    """By which people tell keys apart."""
    return hashlib.sha256(public.public_bytes_raw()).hexdigest()[:ID_DIGITS]


def make_key(path: Path) -> str:
    """Write a new pair: ``path`` for its owner only, and the public key beside it; its id.

    Raises:
        ConfigError: either file is there already, or cannot be written; then neither is.
    """
    public_path = path.with_name(path.name + PUBLIC)
    for one in (path, public_path):
        if one.exists():
            raise ConfigError(f"{one}: is there already, and a key that is overwritten is lost; name another file")
    key = Ed25519PrivateKey.generate()
    public = key.public_key().public_bytes(_PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    private = key.private_bytes(_PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    try:
        write_atomic(public_path, public)
        write_atomic(path, private, mode=0o600)
    except OSError as error:
        public_path.unlink(missing_ok=True)
        raise ConfigError(
            f"{path}: cannot be written: {error.strerror}; name a file in a folder that is there"
        ) from error
    return key_id(key.public_key())


def private_key(path: Path) -> Ed25519PrivateKey:
    """The shop's key; ConfigError where it cannot be read, others may read it, or it is none."""
    content = _read_bytes(path)
    require_private(path, "the shop's key: ")
    try:
        key = serialization.load_pem_private_key(content, password=None)
    except TypeError:
        raise ConfigError(f"{path}: the key has a passphrase, which nobody is there to type; keep it without") from None
    except (ValueError, UnsupportedAlgorithm):
        _none(path, "private")
    return key if isinstance(key, Ed25519PrivateKey) else _none(path, "private")


def public_key(path: Path) -> Ed25519PublicKey:
    """A public key; ConfigError where it cannot be read, or is none."""
    try:
        key = serialization.load_pem_public_key(_read_bytes(path))
    except (ValueError, UnsupportedAlgorithm):
        _none(path, "public")
    return key if isinstance(key, Ed25519PublicKey) else _none(path, "public")


def _none(path: Path, kind: str) -> NoReturn:
    other = f"; the public one is in the file with {PUBLIC} at its end" if kind == "public" else ""
    raise ConfigError(f"{path}: is no {kind} Ed25519 key in PEM; polishd report key FILE makes a pair{other}")


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; name the key's file") from error


def _text(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")
