"""Whether a certificate is as it was made, and by whom: a sentence for each thing that was looked at."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from pydantic import ValidationError

from polishd.console.certificate import seal
from polishd.console.certificate.model import SCHEMA, PartCertificate
from polishd.model.errors import ConfigError

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
        said = seal.canonical(raw)
        same_layout = seal.written(raw) == content
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
        good = seal.holds(signature, raw)
    except ValueError:
        good = False
    if not good:
        words = f"Its signature does not hold: it, or what it signs, was changed since it was made; {ASK}."
        yield VerificationFinding("signature", False, words)
    elif key is None:
        words = f"Unchanged since made, signer not known: the key {signature.key_id} made it; whose that is, only the "
        yield VerificationFinding("signature", True, words + "shop's own public key tells (--key).")
    elif seal.key_id(key) != signature.key_id:
        words = f"It is signed with another key ({signature.key_id}) than the one given ({seal.key_id(key)})."
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
