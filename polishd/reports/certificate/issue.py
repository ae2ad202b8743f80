"""``polishd report certificate | verify | key | schema``."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from polishd.config.cell import load_config
from polishd.model.errors import ConfigError, PolishdError
from polishd.rendering.terminal import emit, key_table, say
from polishd.reports.certificate.options import CertificateOptions
from polishd.util.files import require_writable, write_atomic

PDF, TWIN = ".pdf", ".json"


def certificate_verb(run: Path, asked: CertificateOptions, *, as_json: bool) -> None:
    """Make PDF and twin of a run; ConfigError where it cannot be certified, and then nothing is written."""
    from polishd.reports.certificate import signature as seal
    from polishd.reports.certificate.content import CertificateRequest, certificate_content
    from polishd.reports.certificate.sources import find_run

    twin_path = _require_new(asked.out)
    key_path, shop = _of_cell(run, asked)
    key = None if key_path is None else seal.private_key(key_path)
    said = CertificateRequest(asked.operator, asked.customer, asked.drawing, asked.number, shop, asked.wavelength)
    drawn = certificate_content(find_run(run, asked.job), _printable(said))
    signed_by = "" if key is None else seal.key_id(key.public_key())
    pdf, pages = _drawn(drawn, signed_by)
    digest = hashlib.sha256(pdf).hexdigest()
    content = json.loads(drawn.content.model_dump_json(by_alias=True))
    content["pdf"] = {"name": asked.out.name, "sha256": digest, "bytes": len(pdf), "pages": pages}
    twin = {**content, seal.SEAL: seal.sealed(content, key).model_dump(mode="json")}
    _write(asked.out, pdf, twin_path, seal.written(twin))
    _tell(asked.out, twin, pages, as_json=as_json)


def verify_verb(file: Path, key: Path | None, *, as_json: bool) -> None:
    """A sentence a finding; PolishdError after them where anything is wrong."""
    from polishd.reports.certificate import signature as seal
    from polishd.reports.certificate.signature import verify

    found = verify(file, None if key is None else seal.public_key(key))
    facts = {"number": found.number, "right": found.right, "signer": found.signer}
    emit(
        {**facts, "findings": [asdict(one) for one in found.findings]},
        as_json=as_json,
        lines=[f"{'WRONG: ' * (one.right is False)}{one.words}" for one in found.findings],
    )
    if not found.right:
        raise PolishdError(f"{file}: certificate {found.number} is not as it was made, or not by whom it should be")


def key_verb(file: Path, *, as_json: bool) -> None:
    """Make the shop's key pair."""
    from polishd.reports.certificate import signature as seal

    name = seal.make_key(file)
    public = file.with_name(file.name + seal.PUBLIC)
    rows = [("private, for signing", str(file)), ("public, for customers", str(public)), ("id", name)]
    emit(
        {"private": str(file), "public": str(public), "id": name},
        as_json=as_json,
        table=lambda: key_table("a key for certificates", rows),
        lines=[
            "Keep the private file where only the shop can read it; give the public one to customers by another way."
        ],
    )


def schema_verb() -> None:
    """Print the JSON Schema of twins."""
    from polishd.reports.certificate.model import schema

    say(json.dumps(schema(), indent=2))


def _require_new(out: Path) -> Path:
    """The twin's path; ConfigError where the two files cannot be made there."""
    if out.suffix.lower() != PDF:
        raise ConfigError(f"{out}: a certificate is a PDF; name it *.pdf")
    twin = out.with_suffix(TWIN)
    for path in (out, twin):
        if path.exists():
            raise ConfigError(
                f"{path}: is there already, and a certificate is not overwritten; name another with --out"
            )
    if not out.parent.is_dir():
        raise ConfigError(f"{out.parent}: is no folder; make it, or name another with --out")
    require_writable(out.parent)
    return twin


def _of_cell(run: Path, asked: CertificateOptions) -> tuple[Path | None, str]:
    """Key and shop: as asked, else the cell's, where the run is named by its cell."""
    if run.suffix != ".toml" or run.is_dir():
        return asked.key, asked.shop
    config = load_config(run)
    own = config.certificate
    return asked.key or (None if own.key is None else config.resolve(own.key)), asked.shop or own.shop


def _printable(said: Any) -> Any:
    """ConfigError where something that is said cannot be printed on one line."""
    for name in ("operator", "customer", "drawing", "number", "shop"):
        if not getattr(said, name).isprintable():
            raise ConfigError(f"--{name}: has letters that cannot be printed; write it on one line")
    return replace(said, number=said.number.strip())


def _drawn(drawn: Any, signed_by: str) -> tuple[bytes, int]:
    from polishd.rendering.pdf import paged
    from polishd.reports.certificate.document import sheet

    return paged(sheet(drawn, signed_by))


def _write(pdf_path: Path, pdf: bytes, twin_path: Path, twin: bytes) -> None:
    """Both, or neither."""
    try:
        write_atomic(pdf_path, pdf)
        write_atomic(twin_path, twin)
    except OSError as error:
        pdf_path.unlink(missing_ok=True)
        twin_path.unlink(missing_ok=True)
        raise ConfigError(
            f"{twin_path.parent}: cannot be written: {error.strerror}; name another with --out"
        ) from error


def _tell(out: Path, twin: dict[str, Any], pages: int, *, as_json: bool) -> None:
    signature = twin["seal"]["signature"]
    signed = f"signed with the key {signature['key_id']}" if signature else "not signed: no --key, no certificate.key"
    rows = [
        ("verdict", twin["verdict"]["words"]),
        ("decided by", twin["verdict"]["decided_by"]),
        ("PDF", f"{out}, {pages} pages"),
        ("twin", str(out.with_suffix(TWIN))),
        ("signature", signed),
        *(("left out", reason) for reason in twin["left_out"]),
    ]
    emit(
        {"number": twin["number"], "verdict": twin["verdict"], "pdf": str(out), "twin": str(out.with_suffix(TWIN)),
         "pages": pages, "key_id": signature["key_id"] if signature else None, "left_out": twin["left_out"]},
        as_json=as_json,
        table=lambda: key_table(f"certificate {twin['number']}", rows),
    )  # fmt: skip
