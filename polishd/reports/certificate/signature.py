"""The seal of a certificate: the twin's canonical bytes, their hash, and the shop's signature over them."""

from __future__ import annotations

import base64
import binascii
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
from polishd.util.files import write_atomic
from polishd.util.secret_files import require_private

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


# Whether a certificate is as it was made, and by whom: a sentence for each thing that was looked at.

TWIN, PDF = ".json", ".pdf"
ASK = "ask the shop for the certificate again"


@dataclass(frozen=True, slots=True)
class VerificationFinding:
    """What was found of one thing."""

    about: str
    """``content``, ``signature`` or ``pdf``."""
    right: bool | None
    """None: nothing is wrong, and nothing is proved."""
    words: str


@dataclass(frozen=True, slots=True)
class Verified:
    """What was found of a certificate."""

    number: str
    findings: tuple[VerificationFinding, ...]
    signer: str
    """The id of the key that was given, where it signed; else empty."""

    @property
    def right(self) -> bool:
        """Nothing was found wrong."""
        return all(one.right is not False for one in self.findings)


def verify(path: Path, key: Ed25519PublicKey | None) -> Verified:
    """Look at a certificate, named by its PDF or its twin.

    Args:
        path: either of both; the other one is looked for beside it.
        key: the shop's public one, got from the shop by another way than the certificate; None: it is not at hand.

    Raises:
        ConfigError: there is no twin, or it is no certificate.
    """
    twin_path = path.with_suffix(TWIN) if path.suffix.lower() == PDF else path
    content = _read_certificate(twin_path, path)
    raw, twin = _parsed(twin_path, content)
    signed_by = "" if key is None or twin.seal.signature is None else twin.seal.signature.key_id
    findings = (*_content(twin_path, content, raw, twin), *_signature(raw, twin, key), _pdf(path, twin_path, twin))
    proved = all(one.right for one in findings if one.about != "pdf")
    return Verified(twin.number, findings, signed_by if proved else "")


def _read_certificate(twin_path: Path, asked: Path) -> bytes:
    try:
        return twin_path.read_bytes()
    except OSError as error:
        why = f"{twin_path}: cannot be read: {error.strerror}"
        if twin_path != asked:
            why += f"; a PDF is verified by its twin, the JSON file of the same name: put it beside {asked.name}"
        raise ConfigError(f"{why}; name a certificate") from error


def _parsed(path: Path, content: bytes) -> tuple[dict[str, Any], PartCertificate]:
    try:
        raw = json.loads(content, parse_constant=_refused)
        if not isinstance(raw, dict) or raw.get("schema") != SCHEMA:
            raise ConfigError(f"{path}: is no certificate of this polishd (schema {SCHEMA}); name one")
        return raw, PartCertificate.model_validate(raw)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise ConfigError(f"{path}: is no whole certificate: {place}: {first['msg']}; {ASK}") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: is no JSON ({error}): it was changed or cut off; {ASK}") from None


def _refused(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number")


def _content(path: Path, content: bytes, raw: dict[str, Any], twin: PartCertificate) -> Iterator[VerificationFinding]:
    try:
        said = canonical(raw)
        same_layout = written(raw) == content
    except ValueError:  # a lone surrogate, which no certificate has
        said, same_layout = b"", False
    if hashlib.sha256(said).hexdigest() != twin.seal.sha256:
        yield VerificationFinding(
            "content", False, f"{path.name} was changed since it was made: its checksum does not hold; {ASK}."
        )
    elif not same_layout:
        yield VerificationFinding(
            "content", False, f"{path.name} was written anew since it was made, with the same content; {ASK}."
        )
    else:
        yield VerificationFinding("content", True, f"{path.name} is as its seal says: its checksum holds.")


def _signature(
    raw: dict[str, Any], twin: PartCertificate, key: Ed25519PublicKey | None
) -> Iterator[VerificationFinding]:
    signature = twin.seal.signature
    if signature is None:
        words = (
            "It is not signed: its checksum tells an accident, and no author; whoever changed it could make it anew."
        )
        yield VerificationFinding("signature", None if key is None else False, words)
        return
    try:
        good = holds(signature, raw)
    except ValueError:
        good = False
    if not good:
        words = f"Its signature does not hold: it, or what it signs, was changed since it was made; {ASK}."
        yield VerificationFinding("signature", False, words)
    elif key is None:
        words = f"Unchanged since made, signer not known: the key {signature.key_id} made it; whose that is, only the "
        yield VerificationFinding("signature", True, words + "shop's own public key tells (--key).")
    elif key_id(key) != signature.key_id:
        words = f"It is signed with another key ({signature.key_id}) than the one given ({key_id(key)})."
        yield VerificationFinding("signature", False, words)
    else:
        yield VerificationFinding(
            "signature", True, f"Signed with the given key ({signature.key_id}), and unchanged since."
        )


def _pdf(asked: Path, twin_path: Path, twin: PartCertificate) -> VerificationFinding:
    """The PDF that was named, or the one that the twin names beside it."""
    path = asked if asked != twin_path else twin_path.with_name(Path(twin.pdf.name).name)
    try:
        content = path.read_bytes()
    except OSError as error:
        right = None if asked == twin_path else False
        return VerificationFinding("pdf", right, f"{path.name} was not looked at: {error.strerror}.")
    if hashlib.sha256(content).hexdigest() == twin.pdf.sha256:
        return VerificationFinding("pdf", True, f"{path.name} is the PDF that was made with it, unchanged.")
    return VerificationFinding(
        "pdf", False, f"{path.name} was changed since it was made, or is of another certificate; {ASK}."
    )
