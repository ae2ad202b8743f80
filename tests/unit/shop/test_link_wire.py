"""A cell's requests to its shop on real connections: meaning of answers, trusted servers, and what it never sends."""

from __future__ import annotations

import http.server
import json
import shutil
import ssl
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from polishd.config.server_sections import ShopLinkSection
from polishd.model.errors import ConfigError, LinkError, TokenRefused
from polishd.shop import link as module
from polishd.shop.link import ShopClient
from tests.certificates import DAY_S, Authority

TOKEN = "not-to-be-shown"


@contextmanager
def serving(status: int, body: bytes, context: ssl.SSLContext | None = None) -> Iterator[tuple[int, list[Any]]]:
    """A server that answers so; its port, and what it was asked."""
    asked: list[Any] = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            content = self.rfile.read(int(self.headers["Content-Length"]))
            asked.append((self.path, self.headers["Authorization"], json.loads(content)))
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Location", "/elsewhere")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: Any) -> None:
            """Discard the log."""

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        if context is not None:
            server.socket = context.wrap_socket(server.socket, server_side=True)
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        try:
            yield server.server_address[1], asked
        finally:
            server.shutdown()


def wire(folder: Path, port: int, scheme: str = "http", host: str = "127.0.0.1", **more: Any) -> ShopClient:
    token = folder / "shop.token"
    token.write_text(TOKEN + "\n")
    token.chmod(0o600)
    return ShopClient(ShopLinkSection(url=f"{scheme}://{host}:{port}", token="file:shop.token", **more), folder)


def test_it_brings_its_token_and_reads_json(tmp_path: Path) -> None:
    with serving(200, b'{"ok": true, "upto": 3}') as (port, asked):
        assert wire(tmp_path, port).request("/api/cell/report", {"first": 1}) == {"ok": True, "upto": 3}
        assert wire(tmp_path, port).fetch("/api/cell/file", {}) == b'{"ok": true, "upto": 3}'
    assert asked[0] == ("/api/cell/report", f"Bearer {TOKEN}", {"first": 1})


@pytest.mark.parametrize(
    ("status", "kind", "says"),
    [
        (400, ConfigError, "answered 400: wrong"),
        (401, TokenRefused, r"does not take this cell's token \(wrong\)"),
        (302, ConfigError, "answered 302: wrong"),
        (429, LinkError, "answered 429: wrong"),
        (500, LinkError, "answered 500: wrong"),
        (502, LinkError, "answered 502: wrong"),
    ],
)
def test_a_refusal_is_distinguished_from_a_shop_that_is_away(
    tmp_path: Path, status: int, kind: type[Exception], says: str
) -> None:
    with serving(status, b'{"ok": false, "error": "wrong"}') as (port, asked), pytest.raises(kind, match=says):
        wire(tmp_path, port).request("/", {})
    assert len(asked) == 1, "nothing is repeated, and no redirection is followed"


@pytest.mark.parametrize("body", [b"", b"<html>", b"[1]", b"\xff"])
def test_what_is_no_answer_of_a_shop_is_no_answer(tmp_path: Path, body: bytes) -> None:
    with serving(200, body) as (port, _), pytest.raises(LinkError, match="is that a shop"):
        wire(tmp_path, port).request("/", {})


def test_an_answer_without_end_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_BYTES", 10)
    with serving(200, b"x" * 100) as (port, _), pytest.raises(LinkError, match="more than 10 bytes"):
        wire(tmp_path, port).request("/", {})


def test_a_shop_that_is_away_is_named_and_the_token_is_not(tmp_path: Path) -> None:
    with serving(200, b"{}") as (port, _):
        pass
    with pytest.raises(LinkError, match=rf"http://127\.0\.0\.1:{port}: ") as caught:
        wire(tmp_path, port).request("/", {})
    assert TOKEN not in str(caught.value)


def test_a_token_that_is_changed_counts_at_once(tmp_path: Path) -> None:
    with serving(200, b"{}") as (port, asked):
        made = wire(tmp_path, port)
        (tmp_path / "shop.token").write_text("another\n")
        made.request("/", {})
    assert asked[0][1] == "Bearer another"


def test_by_tls_only_a_certificate_that_is_trusted_gets_the_token(tmp_path: Path) -> None:
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("openssl is not installed: apt-get install openssl")
    command = [openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=office"]
    command += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", "key.pem", "-out", "cert.pem"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "cert.pem", tmp_path / "key.pem")
    with serving(200, b'{"ok": true}', context) as (port, asked):
        assert wire(tmp_path, port, "https", ca_file="cert.pem").request("/", {}) == {"ok": True}
        with pytest.raises(LinkError, match="certificate verify failed"):
            wire(tmp_path, port, "https").request("/", {})
        with pytest.raises(LinkError, match="certificate"):
            wire(tmp_path, port, "https", host="localhost", ca_file="cert.pem").request("/", {})
    assert len(asked) == 1
    with pytest.raises(ConfigError, match=r"none\.pem: cannot be read"):
        wire(tmp_path, 1, "https", ca_file="none.pem")


@pytest.mark.parametrize(
    ("valid_s", "hosts", "ca_file", "says"),
    [
        (-60.0, ["127.0.0.1"], "ca.pem", r"certificate has expired\. Renew it at the shop: cert and key in \[web\]"),
        (60.0, ["127.0.0.2"], "ca.pem", r"IP address mismatch.*Write in shop\.url the name that is in the certificate"),
        (60.0, ["127.0.0.1"], "other.pem", r"signed by none of .*other\.pem\. Name the file .* with shop\.ca_file"),
    ],
)
def test_a_certificate_that_is_not_believed_says_why_and_what_to_do(
    tmp_path: Path, valid_s: float, hosts: list[str], ca_file: str, says: str
) -> None:
    house = Authority()
    house.write(tmp_path / "ca.pem")
    Authority("other").write(tmp_path / "other.pem")
    house.certify(tmp_path, valid_s, hosts)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "cert.pem", tmp_path / "key.pem")
    with serving(200, b"{}", context) as (port, asked), pytest.raises(LinkError, match=says) as found:
        wire(tmp_path, port, "https", ca_file=ca_file).request("/", {})
    assert asked == [], "the token is not sent"
    assert "tries again; nothing was sent" in str(found.value)
    assert "\n" not in str(found.value)


def test_a_certificate_that_expires_soon_is_said_once_a_day(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    house = Authority()
    house.write(tmp_path / "ca.pem")
    house.certify(tmp_path, 5 * DAY_S)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "cert.pem", tmp_path / "key.pem")
    with serving(200, b"{}", context) as (port, asked):
        made = wire(tmp_path, port, "https", ca_file="ca.pem")
        for _ in range(3):
            made.request("/", {})
        (said,) = caplog.messages
        assert "the shop's TLS certificate expires on " in said
        assert "in 5.0 days. Renew it at the shop" in said
        monkeypatch.setattr(module, "AGAIN_S", 0.0)
        made.request("/", {})
    assert len(caplog.messages) == 2
    assert len(asked) == 4


def test_an_authority_that_is_replaced_is_believed_without_a_restart(tmp_path: Path) -> None:
    old, new = Authority("old"), Authority("new")
    old.write(tmp_path / "ca.pem")
    new.certify(tmp_path)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "cert.pem", tmp_path / "key.pem")
    with serving(200, b"{}", context) as (port, asked):
        made = wire(tmp_path, port, "https", ca_file="ca.pem")
        with pytest.raises(LinkError, match="certificate verify failed"):
            made.request("/", {})
        (tmp_path / "ca.pem").unlink()
        with pytest.raises(ConfigError, match=r"ca\.pem: cannot be read"):
            made.request("/", {})
        new.write(tmp_path / "ca.pem")
        assert made.request("/", {}) == {}
    assert len(asked) == 1


def test_a_token_that_is_refused_says_where_to_get_one_and_a_new_one_is_seen(tmp_path: Path) -> None:
    with serving(401, b'{"error": "bring a token"}') as (port, _):
        made = wire(tmp_path, port)
        assert made.has_new_token(), "none was refused"
        with pytest.raises(TokenRefused, match=r"polishd shop serve SHOP\.toml --add-cell NAME") as found:
            made.request("/", {})
        assert str(tmp_path / "shop.token") in str(found.value)
        assert TOKEN not in str(found.value)
        assert not made.has_new_token()
        (tmp_path / "shop.token").unlink()
        assert not made.has_new_token(), "it is being written"
        wire(tmp_path, port)
        (tmp_path / "shop.token").write_text("another\n")
        assert made.has_new_token()
