"""Requests of a cell to its shop: HTTP by its token, over TLS, or on this computer."""

from __future__ import annotations

import hashlib
import json
import logging
import ssl
import time
from collections.abc import Mapping
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from polishd.config.shop_link import ShopLinkSection
from polishd.model.errors import ConfigError, LinkError, TokenRefused
from polishd.secret import hide, read_secret

log = logging.getLogger(__name__)

STEP_S = 15.0
"""Longest that the shop may leave a step unanswered."""
MOST_BYTES = 32 << 20
SERVER_ERRORS = 500
WARN_S, AGAIN_S = 21 * 86400.0, 86400.0
"""So long before the shop's certificate expires that is said, and after so long again."""
NOT_YET_VALID, EXPIRED = 9, 10
UNKNOWN_ISSUER, OTHER_NAME = (18, 19, 20, 21), (62, 64)
"""OpenSSL's numbers of why a certificate is not believed (X509_V_ERR_...)."""


class ShopClient:
    """One request after the other; each on a connection of its own. No proxy, no redirection."""

    def __init__(self, section: ShopLinkSection, base_dir: Path) -> None:
        """ConfigError where there is no token, or whom to trust cannot be read."""
        self._section, self._base_dir = section, base_dir
        self._ca_file = None if section.ca_file is None else base_dir / Path(section.ca_file).expanduser()
        self._context, self._trusted = self._trusting(), self._signature()
        self._refused = ""
        """Hash of the token that the shop refused last."""
        self._warned_s = float("-inf")
        read_secret(section.token, base_dir)

    def has_new_token(self) -> bool:
        """Return whether there is a token now that the shop has not refused."""
        try:
            return _hash(read_secret(self._section.token, self._base_dir)) != self._refused
        except ConfigError:
            return False

    def ask(self, path: str, said: Mapping[str, Any]) -> dict[str, Any]:
        """The answer; ConfigError where the shop refuses, LinkError where it is not there, or did not take it."""
        content = self.fetch(path, said)
        try:
            found = json.loads(content)
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise LinkError(f"{self._section.url}: its answer is no JSON object; is that a shop?")
        return found

    def fetch(self, path: str, said: Mapping[str, Any]) -> bytes:
        """The same, as it came. TokenRefused where the shop does not take the token."""
        token = read_secret(self._section.token, self._base_dir)
        if (trusted := self._signature()) != self._trusted:
            self._context, self._trusted = self._trusting(), trusted
        try:
            status, content = self._post(path, json.dumps(dict(said)).encode(), token)
        except ssl.SSLCertVerificationError as error:
            raise LinkError(f"{self._section.url}: {self._distrust(error)}") from None
        except (OSError, HTTPException, ValueError) as error:
            raise LinkError(hide(f"{self._section.url}: {type(error).__name__}: {error}", token)) from None
        if status == 200:
            return content
        if status == 401:
            self._refused = _hash(token)
            raise TokenRefused(self._refusal(_error(content)))
        why = f"{self._section.url}: answered {status}: {_error(content)}"
        raise LinkError(why) if status >= SERVER_ERRORS or status in {408, 429} else ConfigError(why)

    def _post(self, path: str, body: bytes, token: str) -> tuple[int, bytes]:
        parts = urlsplit(self._section.url)
        host = str(parts.hostname)
        if parts.scheme == "https":
            connection: HTTPConnection = HTTPSConnection(host, parts.port, timeout=STEP_S, context=self._context)
        else:
            connection = HTTPConnection(host, parts.port, timeout=STEP_S)
        try:
            connection.connect()
            self._look_at_certificate(connection.sock)
            headers = {"Content-Type": "application/json", "Authorization": f"Bearer {token}"}
            connection.request("POST", path, body, headers)
            with connection.getresponse() as answer:
                content = answer.read(MOST_BYTES)
                if not answer.isclosed():
                    raise HTTPException(f"its answer is more than {MOST_BYTES} bytes")
                return answer.status, content
        finally:
            connection.close()

    # whom to trust

    def _trusting(self) -> ssl.SSLContext:
        try:
            return ssl.create_default_context(cafile=self._ca_file)
        except (OSError, ssl.SSLError) as error:
            raise ConfigError(f"{self._ca_file}: cannot be read: {error}; name a file of certificates (PEM)") from error

    def _signature(self) -> tuple[int, int, int] | None:
        """Whether the file is the one that was read."""
        if self._ca_file is None:
            return None
        try:
            stat = self._ca_file.stat()
        except OSError:
            return (0, 0, 0)
        return (stat.st_mtime_ns, stat.st_ino, stat.st_size)

    def _look_at_certificate(self, connection: Any) -> None:
        """Warn once a day where the shop's certificate expires soon."""
        if not isinstance(connection, ssl.SSLSocket):
            return
        ends = str((connection.getpeercert() or {}).get("notAfter", ""))
        left_s = ssl.cert_time_to_seconds(ends) - time.time() if ends else WARN_S
        if left_s < WARN_S and time.monotonic() - self._warned_s >= AGAIN_S:
            self._warned_s = time.monotonic()
            log.warning(
                "%s: the shop's TLS certificate expires on %s, in %.1f days. Renew it at the shop: cert and key in "
                "[web] of SHOP.toml; then nothing here stops",
                self._section.url, ends, left_s / 86400,
            )  # fmt: skip

    def _distrust(self, error: ssl.SSLCertVerificationError) -> str:
        """What is wrong with the shop's certificate, and what to do, by OpenSSL's own number."""
        ca_file = "the system's authorities" if self._ca_file is None else str(self._ca_file)
        todo = {
            EXPIRED: "Renew it at the shop: cert and key in [web] of SHOP.toml. If it is not expired, set this "
            "computer's clock",
            NOT_YET_VALID: "Set the clocks of this computer and of the shop's",
            **dict.fromkeys(
                UNKNOWN_ISSUER,
                f"It is signed by none of {ca_file}. Name the file of the authority that signed it with shop.ca_file",
            ),
            **dict.fromkeys(OTHER_NAME, "It is another host's. Write in shop.url the name that is in the certificate"),
        }.get(error.verify_code, "Look at cert in [web] of SHOP.toml, and at shop.ca_file")
        return (
            f"certificate verify failed: {error.verify_message}. {todo}. The link tries again by itself; nothing was "
            "sent"
        )

    def _refusal(self, said: str) -> str:
        kind, _, name = self._section.token.partition(":")
        where = f"write it into {self._base_dir / Path(name).expanduser()}; the link takes it up by itself"
        if kind == "env":
            where = f"put it into {name}, and start the link again"
        return (
            f"{self._section.url}: the shop does not take this cell's token ({said}). Make a new one at the shop: "
            f"polishd shop serve SHOP.toml --add-cell NAME, and {where}"
        )


def _hash(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()


def _error(content: bytes) -> str:
    try:
        return str(json.loads(content)["error"])[:500]
    except (ValueError, KeyError, TypeError):
        return " ".join(content[:200].decode("utf-8", "replace").split())
