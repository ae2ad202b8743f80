"""Keys, seals, and every kind of change that must be noticed."""

from __future__ import annotations

import json
import shutil
import stat
import subprocess
from base64 import b64decode
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from polishd.model.errors import ConfigError
from polishd.reports.certificate import signature as seal
from polishd.reports.certificate.model import PartCertificate
from polishd.reports.certificate.signature import Verified, verify
from tests.unit.reports.certificate.conftest import Made

Change = Callable[[dict[str, Any]], None]


def results(found: Verified) -> dict[str, bool | None]:
    """What each check found: True is right, False is wrong, None is neither."""
    return {one.about: one.right for one in found.findings}


def text_of(found: Verified, about: str) -> str:
    return next(one.words for one in found.findings if one.about == about)


UNCHANGED = {"content": True, "signature": True, "pdf": True}


def rewrite(made: Made, change: Change) -> None:
    """Another content, in the layout of a twin."""
    twin = json.loads(made.twin.read_bytes())
    change(twin)
    made.twin.write_bytes(seal.written(twin))


def resealed(twin: dict[str, Any], key: Ed25519PrivateKey | None) -> None:
    """Seal the changed twin again, as a forger would."""
    twin["seal"] = seal.sealed(twin, key).model_dump(mode="json")


def better(twin: dict[str, Any]) -> None:
    twin["measurements"][-1]["rms_nm"] = 0.01


# keys


def test_a_key_pair_is_the_owners(tmp_path: Path) -> None:
    path = tmp_path / "shop.key"
    name = seal.make_key(path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE((tmp_path / "shop.key.pub").stat().st_mode) == 0o644
    assert seal.key_id(seal.private_key(path).public_key()) == name
    assert seal.key_id(seal.public_key(tmp_path / "shop.key.pub")) == name


@pytest.mark.parametrize("there", ["shop.key", "shop.key.pub"])
def test_a_key_is_never_overwritten(tmp_path: Path, there: str) -> None:
    (tmp_path / there).write_text("mine")
    with pytest.raises(ConfigError, match=f"{there}: exists"):
        seal.make_key(tmp_path / "shop.key")
    assert [path.name for path in tmp_path.iterdir()] == [there]
    assert (tmp_path / there).read_text() == "mine"


def test_a_key_that_cannot_be_written_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, content: bytes, mode: int = 0o644) -> None:
        if not path.name.endswith(".pub"):
            raise OSError(28, "No space left on device")
        path.write_bytes(content)

    monkeypatch.setattr(seal, "write_atomic", full)
    with pytest.raises(ConfigError, match="No space left on device"):
        seal.make_key(tmp_path / "shop.key")
    assert list(tmp_path.iterdir()) == []


def test_a_key_on_a_read_only_disk_is_a_config_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_args: object, **_options: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(seal, "write_atomic", refused)
    monkeypatch.setattr(Path, "unlink", refused)
    with pytest.raises(ConfigError, match=r"shop\.key: cannot be written: Read-only file system"):
        seal.make_key(tmp_path / "shop.key")


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660])
def test_a_key_that_others_may_read_signs_nothing(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "shop.key"
    seal.make_key(path)
    path.chmod(mode)
    with pytest.raises(ConfigError, match=rf"the shop's key: mode {mode:04o} of .*Run: chmod 600 {path}"):
        seal.private_key(path)


def pem(key: Any, *, passphrase: bytes | None = None) -> bytes:
    how = serialization.BestAvailableEncryption(passphrase) if passphrase else serialization.NoEncryption()
    found: bytes = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, how)
    return found


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not a private Ed25519 key"),
        (b"-----BEGIN PRIVATE KEY-----\nQUJD\n-----END PRIVATE KEY-----\n", "not a private Ed25519 key"),
        (pem(generate_private_key(SECP256R1())), "not a private Ed25519 key"),
        (pem(Ed25519PrivateKey.generate(), passphrase=b"secret"), "has a passphrase"),
    ],
    ids=["empty", "cut off", "another kind", "with a passphrase"],
)
def test_what_is_no_key_is_named(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "shop.key"
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(ConfigError, match=said):
        seal.private_key(path)
    with pytest.raises(ConfigError, match="not a public Ed25519 key"):
        seal.public_key(path)
    with pytest.raises(ConfigError, match="cannot be read"):
        seal.public_key(tmp_path / "none")


# canonical bytes


def test_canonical_bytes_are_as_documented() -> None:
    twin = {"b": [1.5, 1e-07, -0.0, None, True], "ä": "µm", "a": {"d": 1, "c": "\u2028"}, "seal": {"sha256": ""}}
    expected = '{"a":{"c":"\u2028","d":1},"b":[1.5,1e-07,-0.0,null,true],"ä":"µm"}'
    assert seal.canonical(twin) == expected.encode()
    with pytest.raises(ValueError, match="not JSON compliant"):
        seal.canonical({"a": float("nan")})


@pytest.mark.full
def test_a_twin_reads_back_as_it_was_written(certified: Made) -> None:
    content = certified.twin.read_bytes()
    assert seal.written(json.loads(content)) == content
    twin = PartCertificate.model_validate_json(content)
    again = json.loads(twin.model_dump_json(by_alias=True))
    assert again == json.loads(content), "the model says all of it"
    assert seal.canonical(again) == seal.canonical(json.loads(content))


# verifying


def public(made: Made) -> Ed25519PublicKey:
    return seal.public_key(made.public)


@pytest.mark.full
@pytest.mark.parametrize("named", ["pdf", "twin"])
def test_unchanged(signed: Made, named: str) -> None:
    found = verify(getattr(signed, named), public(signed))
    assert found.right
    assert found.signer == seal.key_id(public(signed))
    assert results(found) == UNCHANGED


def test_without_the_shops_key_the_signer_is_not_known(signed: Made) -> None:
    found = verify(signed.pdf, None)
    assert found.right
    assert found.signer == ""
    assert results(found) == UNCHANGED


def test_a_changed_pdf_is_noticed(signed: Made) -> None:
    content = bytearray(signed.pdf.read_bytes())
    content[len(content) // 2] ^= 1
    signed.pdf.write_bytes(content)
    found = verify(signed.pdf, public(signed))
    assert results(found) == UNCHANGED | {"pdf": False}
    assert not verify(signed.twin, None).right, "named by its JSON file, too"


def change_number(twin: dict[str, Any]) -> None:
    twin["number"] += "1"


def change_verdict(twin: dict[str, Any]) -> None:
    twin["verdict"]["lines"][0]["holds"] = False


def change_hash(twin: dict[str, Any]) -> None:
    twin["pdf"]["sha256"] = "0" * 64


def change_checksum(twin: dict[str, Any]) -> None:
    twin["seal"]["sha256"] = "0" * 64


def change_last_digit(twin: dict[str, Any]) -> None:
    twin["measurements"][0]["rms_nm"] *= 1 + 1e-15


@pytest.mark.parametrize(
    "change", [better, change_number, change_verdict, change_hash, change_checksum, change_last_digit]
)
def test_a_changed_twin_is_noticed(signed: Made, change: Change) -> None:
    rewrite(signed, change)
    found = verify(signed.pdf, public(signed))
    assert not found.right
    assert results(found)["content"] is False
    assert "part.json was changed" in text_of(found, "content")
    assert found.signer == ""


def test_a_new_checksum_helps_no_forger(signed: Made) -> None:
    def forge(twin: dict[str, Any]) -> None:
        signature = twin["seal"]["signature"]
        better(twin)
        resealed(twin, None)
        twin["seal"]["signature"] = signature

    rewrite(signed, forge)
    found = verify(signed.twin, None)
    assert results(found) == UNCHANGED | {"signature": False}


def test_a_forgers_own_key_is_not_the_shops(signed: Made) -> None:
    def forge(twin: dict[str, Any]) -> None:
        better(twin)
        resealed(twin, Ed25519PrivateKey.generate())

    rewrite(signed, forge)
    found = verify(signed.twin, public(signed))
    assert results(found) == UNCHANGED | {"signature": False}
    assert seal.key_id(public(signed)) in text_of(found, "signature")
    assert verify(signed.twin, None).right, "without the shop's key only a change can be found"


def test_a_signature_of_another_certificate_does_not_hold(signed: Made) -> None:
    other = seal.sealed({"number": "another"}, seal.private_key(signed.key)).signature
    assert other is not None

    def swap(twin: dict[str, Any]) -> None:
        twin["seal"]["signature"] = other.model_dump()

    rewrite(signed, swap)
    assert results(verify(signed.twin, public(signed)))["signature"] is False


def damaged(key: str, value: str) -> Change:
    def change(twin: dict[str, Any]) -> None:
        twin["seal"]["signature"][key] = value

    return change


@pytest.mark.parametrize(
    "change",
    [damaged("value", "AAAA"), damaged("value", "no base64"), damaged("key", "AAAA"), damaged("key_id", "0" * 16)],
)
def test_a_damaged_signature_does_not_hold(signed: Made, change: Change) -> None:
    rewrite(signed, change)
    found = verify(signed.pdf, None)
    assert results(found)["signature"] is False
    assert not found.right


def test_a_signature_that_is_taken_off_is_missed_by_who_has_the_key(signed: Made) -> None:
    rewrite(signed, lambda twin: resealed(twin, None))
    assert not verify(signed.pdf, public(signed)).right
    found = verify(signed.pdf, None)
    assert found.right
    assert results(found) == UNCHANGED | {"signature": None}


@pytest.mark.parametrize(
    "layout", [lambda text: json.dumps(json.loads(text)), lambda text: text + "\n"], ids=["blanks", "end"]
)
def test_another_layout_is_noticed(signed: Made, layout: Callable[[str], str]) -> None:
    signed.twin.write_text(layout(signed.twin.read_text()))
    found = verify(signed.twin, None)
    assert results(found) == UNCHANGED | {"content": False}
    assert "rewritten with the same content" in text_of(found, "content")


def test_a_key_that_stands_twice_is_noticed(signed: Made) -> None:
    """Some programs take the first of both, some the last."""
    text = signed.twin.read_text()
    signed.twin.write_text(text.replace("{\n", '{\n "number": "another",\n', 1))
    found = verify(signed.twin, public(signed))
    assert results(found) == UNCHANGED | {"content": False}


def test_alone_the_twin_can_be_verified_and_the_pdf_cannot(signed: Made, tmp_path: Path) -> None:
    signed.pdf.unlink()
    found = verify(signed.twin, public(signed))
    assert found.right
    assert results(found) == UNCHANGED | {"pdf": None}
    assert not verify(signed.pdf, None).right, "a PDF that is named must be there"
    signed.twin.rename(tmp_path / "twin.json")
    with pytest.raises(ConfigError, match=r"part\.json: cannot be read"):
        verify(signed.pdf, None)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not JSON"),
        (b"{", "not JSON"),
        (b"\xff", "not JSON"),
        (b"[]", "schema polishd-certificate-1"),
        (b'{"schema": "polishd-certificate-0"}', "schema polishd-certificate-1"),
        (b'{"schema": "polishd-certificate-1"}', "number: Field required"),
        (b'{"schema": "polishd-certificate-1", "number": NaN}', "NaN is not a number"),
        (b"[" * 200_000, "not JSON"),
    ],
    ids=["empty", "cut off", "no text", "a list", "another schema", "not whole", "no number", "too deep"],
)
def test_what_is_no_certificate_is_one_clear_error(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "c.json"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=said):
        verify(path, None)


def test_the_pdfs_name_leads_out_of_no_folder(signed: Made, tmp_path: Path) -> None:
    def away(twin: dict[str, Any]) -> None:
        twin["pdf"]["name"] = "../../somewhere.pdf"

    rewrite(signed, away)
    found = verify(signed.twin, None)
    assert results(found)["pdf"] is None
    assert text_of(found, "pdf").startswith("somewhere.pdf")


def test_any_byte_that_is_changed_is_noticed(signed: Made) -> None:
    """By a finding, or because what is left is no certificate any more: never by a traceback."""
    good, key = signed.twin.read_bytes(), public(signed)
    rng = np.random.default_rng(7)
    for place in rng.integers(0, len(good), 150):
        content = bytearray(good)
        content[place] ^= 1 << int(rng.integers(0, 8))
        signed.twin.write_bytes(content)
        with suppress(ConfigError):
            assert not verify(signed.twin, key).right, place


def test_openssl_verifies_the_signature(signed: Made, tmp_path: Path) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed: apt-get install openssl")
    twin = json.loads(signed.twin.read_bytes())
    said, signature = tmp_path / "said", tmp_path / "signature"
    said.write_bytes(seal.canonical(twin))
    signature.write_bytes(b64decode(twin["seal"]["signature"]["value"]))
    command = ["openssl", "pkeyutl", "-verify", "-pubin", "-inkey", signed.public, "-rawin", "-in", said]
    for content, code in ((said.read_bytes(), 0), (said.read_bytes() + b" ", 1)):
        said.write_bytes(content)
        done = subprocess.run([*command, "-sigfile", signature], capture_output=True, check=False)
        assert done.returncode == code, done.stderr
