"""A server's certificate while it runs: said before it expires, taken up when it is replaced, kept where it is not."""

from __future__ import annotations

import socket
import ssl
import time
from contextlib import suppress
from pathlib import Path

import pytest
from cryptography import x509

from polishd.config.server_sections import CERTIFICATE_WARNING_S, ShopFile, load_shop
from polishd.model.errors import ConfigError
from polishd.web.http.certificates import Certificate
from tests.certificates import DAY_S, Authority
from tests.time_limits import SOON_S


@pytest.fixture
def house() -> Authority:
    return Authority()


def shop_file(folder: Path) -> ShopFile:
    path = folder / "shop.toml"
    path.write_text('[shop]\nname = "office"\nstate_dir = "state"\n[web]\ncert = "cert.pem"\nkey = "key.pem"\n')
    return load_shop(path)


class Clock:
    def __init__(self) -> None:
        self.ahead_s = 0.0

    def __call__(self) -> float:
        return time.time() + self.ahead_s


def made(folder: Path, clock: Clock) -> Certificate:
    found = Certificate.of(shop := shop_file(folder), shop.web)
    assert found is not None
    found._clock = clock
    return found


def shown(certificate: Certificate, name: str | None = None) -> int:
    """The serial number that a client is shown, in memory."""
    server_in, server_out, client_in, client_out = (ssl.MemoryBIO() for _ in range(4))
    trusting = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    server = certificate.context().wrap_bio(server_in, server_out, server_side=True)
    client = trusting.wrap_bio(client_in, client_out, server_hostname=name)
    for _ in range(4):
        for side, out, other in ((client, client_out, server_in), (server, server_out, client_in)):
            with suppress(ssl.SSLWantReadError):  # until the other side has answered
                side.do_handshake()
            other.write(out.read())
    der = client.getpeercert(binary_form=True)
    assert der is not None
    return x509.load_der_x509_certificate(der).serial_number


def test_it_is_said_before_it_expires_once_a_day_and_when_it_has(
    house: Authority, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    house.certify(tmp_path, 90 * DAY_S)
    clock = Clock()
    certificate = made(tmp_path, clock)
    certificate.look()
    assert (caplog.messages, certificate.facts()["wrong"]) == ([], "")
    assert 89.9 < certificate.facts()["days_left"] <= 90
    clock.ahead_s = 90 * DAY_S - CERTIFICATE_WARNING_S + 60
    for _ in range(3):
        certificate.look()
    (said,) = caplog.messages
    assert "cert.pem expires on 20" in said
    assert "in 21.0 days. Renew " in said
    assert said.endswith("taken up without a restart")
    clock.ahead_s += DAY_S
    certificate.look()
    assert len(caplog.messages) == 2
    clock.ahead_s = 90 * DAY_S + 1
    certificate.look()
    assert "expired on 20" in caplog.messages[-1]
    assert "expired on" in certificate.facts()["wrong"]


@pytest.mark.parametrize("name", [None, "shop.example"])
def test_a_new_one_is_taken_up_and_half_of_one_is_not(
    house: Authority, tmp_path: Path, caplog: pytest.LogCaptureFixture, name: str | None
) -> None:
    first = house.certify(tmp_path)
    certificate = made(tmp_path, Clock())
    assert shown(certificate, name) == first
    old_key = (tmp_path / "key.pem").read_bytes()
    second = house.certify(tmp_path)
    new_key = (tmp_path / "key.pem").read_bytes()
    (tmp_path / "key.pem").write_bytes(old_key)  # the certificate came first
    for _ in range(2):
        certificate.look()
    assert shown(certificate, name) == first
    (said,) = caplog.messages
    assert "web.key: " in said
    assert "goes on with the certificate that it has" in said
    assert certificate.facts()["wrong"] == said
    (tmp_path / "key.pem").write_bytes(new_key)
    certificate.look()
    assert shown(certificate, name) == second
    assert "a new certificate is in use" in caplog.messages[-1]
    assert certificate.facts()["wrong"] == ""


@pytest.mark.parametrize("what", ["gone", "empty", "open to others", "no key"])
def test_files_that_cannot_be_used_end_a_start_with_a_sentence_and_a_server_goes_on(
    house: Authority, tmp_path: Path, what: str, caplog: pytest.LogCaptureFixture
) -> None:
    first = house.certify(tmp_path)
    certificate = made(tmp_path, Clock())
    if what == "gone":
        (tmp_path / "cert.pem").unlink()
    elif what == "empty":
        (tmp_path / "cert.pem").write_bytes(b"")
    elif what == "no key":
        (tmp_path / "key.pem").write_bytes(b"-----")
    else:
        (tmp_path / "key.pem").chmod(0o644)
        (tmp_path / "cert.pem").touch()
    certificate.look()
    assert shown(certificate) == first
    assert len(caplog.messages) == 1
    with pytest.raises(ConfigError, match=r"shop\.toml:\d+: web\.(cert|key): ") as found:
        Certificate.of(shop := shop_file(tmp_path), shop.web)
    assert "\n" not in str(found.value)


@pytest.mark.full
def test_a_served_shop_takes_a_new_certificate_up_and_tells_of_it(house: Authority, tmp_path: Path) -> None:
    """As a process: the next connection is shown the new one, and the one that is open goes on."""
    from tests.unit.web.test_server import serving_verb

    first = house.certify(tmp_path)
    shop_file(tmp_path)
    path = tmp_path / "shop.toml"
    path.write_text(path.read_text() + "port = 0\n")
    house.write(tmp_path / "ca.pem")
    trusting = ssl.create_default_context(cafile=str(tmp_path / "ca.pem"))

    def connected(at: tuple[str, int]) -> ssl.SSLSocket:
        return trusting.wrap_socket(socket.create_connection(at, SOON_S), server_hostname="127.0.0.1")

    def serial(connection: ssl.SSLSocket) -> int:
        der = connection.getpeercert(binary_form=True)
        assert der is not None
        return x509.load_der_x509_certificate(der).serial_number

    request = b"GET /api/status HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    with serving_verb("shop", "serve", str(path)) as at, connected(at) as open_:
        assert serial(open_) == first
        second = house.certify(tmp_path)
        end_s = time.monotonic() + SOON_S
        while True:
            with connected(at) as fresh:
                if serial(fresh) == second:
                    break
            assert time.monotonic() < end_s, "the new certificate was not taken up"
            time.sleep(0.1)
        open_.sendall(request)
        assert open_.recv(1000).startswith(b"HTTP/1.1 401")
