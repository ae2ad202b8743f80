"""``polishd certificate make | verify | keygen | schema``."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from polishd.model.errors import ConfigError, PolishdError
from polishd.rendering.terminal import emit, key_table, say
from polishd.util.files import require_writable_file, write_together

if TYPE_CHECKING:
    from polishd.reports.certificate.content import CertificateDraft, CertificateRequest
    from polishd.reports.certificate.options import CertificateOptions

CERTIFICATE, PDF, JSON = "certificate-", ".pdf", ".json"


def certificate_verb(run: Path, options: CertificateOptions, *, as_json: bool) -> None:
    """Write the PDF and JSON of a run's certificate; ConfigError, and no file, if the run cannot be certified."""
    from polishd.reports.certificate import signature as seal
    from polishd.reports.certificate.content import CertificateRequest, certificate_content
    from polishd.reports.certificate.sources import find_run

    if options.out is not None:
        _require_new(options.out)  # before minutes of work
    key_path, shop = _key_and_shop(run, options)
    key = None if key_path is None else seal.private_key(key_path)
    request = CertificateRequest(
        options.operator, options.customer, options.drawing, options.number, shop, options.wavelength
    )
    certified = find_run(run, options.job)
    draft = certificate_content(certified, _require_printable(request))
    out = options.out or certified.path / certificate_name(draft.content.number)
    json_path = _require_new(out)
    signed_by = "" if key is None else seal.key_id(key.public_key())
    pdf, pages = _drawn(draft, signed_by)
    digest = hashlib.sha256(pdf).hexdigest()
    content = json.loads(draft.content.model_dump_json(by_alias=True))
    content["pdf"] = {"name": out.name, "sha256": digest, "bytes": len(pdf), "pages": pages}
    certificate = {**content, seal.SEAL: seal.sealed(content, key).model_dump(mode="json")}
    _write(out, pdf, json_path, seal.written(certificate))
    _report(out, certificate, pages, as_json=as_json)


def certificate_name(number: str) -> str:
    """Return the name of a certificate's PDF in the run folder."""
    return f"{CERTIFICATE}{re.sub(r'[^A-Za-z0-9._-]+', '-', number)}{PDF}"


def verify_verb(file: Path, key: Path | None, *, as_json: bool) -> None:
    """Print a sentence for each finding; PolishdError after them if anything is wrong."""
    from polishd.reports.certificate import signature as seal

    found = seal.verify(file, None if key is None else seal.public_key(key))
    facts = {"number": found.number, "right": found.right, "signer": found.signer}
    emit(
        {**facts, "findings": [asdict(one) for one in found.findings]},
        as_json=as_json,
        lines=[f"{'WRONG: ' * (one.right is False)}{one.words}" for one in found.findings],
    )
    if not found.right:
        raise PolishdError(
            f"{file}: the verification of certificate {found.number} failed. Request it from the shop again."
        )


def key_verb(file: Path, *, as_json: bool) -> None:
    """Make the key pair of the shop."""
    from polishd.reports.certificate import signature as seal

    name = seal.make_key(file)
    public = file.with_name(file.name + seal.PUBLIC)
    rows = [("private, for signing", str(file)), ("public, for customers", str(public)), ("id", name)]
    emit(
        {"private": str(file), "public": str(public), "id": name},
        as_json=as_json,
        table=lambda: key_table("a key for certificates", rows),
        lines=["Keep the private file secret. Give the public file to customers in another way than the certificates."],
    )


def schema_verb() -> None:
    """Print the JSON Schema of certificates."""
    from polishd.reports.certificate.model import schema

    say(json.dumps(schema(), indent=2))


def _require_new(out: Path) -> Path:
    """Return the path of the JSON file; ConfigError if one of the two files cannot be made."""
    if out.suffix.lower() != PDF:
        raise ConfigError(f"{out}: a certificate is a PDF. Use a name that ends in .pdf.")
    json_path = out.with_suffix(JSON)
    for path in (out, json_path):
        if path.exists():
            raise ConfigError(f"{path}: exists, and a certificate is never overwritten. Name another file with --out.")
    require_writable_file(out)
    return json_path


def _key_and_shop(run: Path, options: CertificateOptions) -> tuple[Path | None, str]:
    """Return the key and the shop: those of the options, else those of the cell's file."""
    if run.suffix != ".toml" or run.is_dir():
        return options.key, options.shop
    from polishd.config.cell import load_config

    config = load_config(run)
    own = config.certificate
    return options.key or (None if own.key is None else config.resolve(own.key)), options.shop or own.shop


def _require_printable(request: CertificateRequest) -> CertificateRequest:
    """ConfigError if a text has control characters."""
    for name in ("operator", "customer", "drawing", "number", "shop"):
        if not getattr(request, name).isprintable():
            raise ConfigError(f"--{name}: has characters that cannot be printed. Write it on one line.")
    return replace(request, number=request.number.strip())


def _drawn(draft: CertificateDraft, signed_by: str) -> tuple[bytes, int]:
    from polishd.rendering.document import paged
    from polishd.reports.certificate.document import certificate_document

    return paged(certificate_document(draft, signed_by))


def _write(pdf_path: Path, pdf: bytes, json_path: Path, json_bytes: bytes) -> None:
    """Write both files, or none."""
    try:
        write_together(json_path.parent, {pdf_path.name: pdf, json_path.name: json_bytes})
    except OSError as error:
        raise ConfigError(
            f"{json_path.parent}: cannot be written: {error.strerror}. Name another folder with --out."
        ) from error


def _report(out: Path, certificate: dict[str, Any], pages: int, *, as_json: bool) -> None:
    signature = certificate["seal"]["signature"]
    signed = f"signed with the key {signature['key_id']}" if signature else "not signed: no --key, no certificate.key"
    rows = [
        ("verdict", certificate["verdict"]["words"]),
        ("decided by", certificate["verdict"]["decided_by"]),
        ("PDF", f"{out}, {pages} pages"),
        ("JSON", str(out.with_suffix(JSON))),
        ("signature", signed),
        *(("left out", reason) for reason in certificate["left_out"]),
    ]
    answer = {key: certificate[key] for key in ("number", "verdict", "left_out")}
    answer |= {"pdf": str(out), "json": str(out.with_suffix(JSON)), "pages": pages}
    answer |= {"key_id": signature["key_id"] if signature else None}
    emit(answer, as_json=as_json, table=lambda: key_table(f"certificate {certificate['number']}", rows))
