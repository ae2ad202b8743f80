"""The TLS certificate of a running server: warn before it expires, and load it again when its files change."""

from __future__ import annotations

import logging
import ssl
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from cryptography import x509

from polishd.config.server_sections import CERTIFICATE_WARNING_S, WebSection
from polishd.config.toml_loader import TomlDocument
from polishd.model.errors import ConfigError, PolishdError
from polishd.rendering.terminal import utc_minute
from polishd.util.files import require_private

log = logging.getLogger(__name__)

POLL_S = 1.0
"""Interval between two checks of the files."""
EXPIRY_AGAIN_S = 86400.0
"""Time until the warning is repeated."""


class Certificate:
    """The files of ``[web]``, and the newest context made from them. New connections use the newest context."""

    def __init__(self, document: TomlDocument, cert: str, key: str, clock: Callable[[], float] = time.time) -> None:
        """ConfigError, with the key's line, where the files are no certificate with its key."""
        self._document, self._clock = document, clock
        self._cert, self._key = document.resolve(cert), document.resolve(key)
        self._checked = self._signature()
        self._first, self._expires_s = self._loaded()
        self._newest = self._first
        self._problem = ""
        self._last_warning: tuple[str, float] = ("", float("-inf"))

    @classmethod
    def of(cls, document: TomlDocument, web: WebSection) -> Self | None:
        """Certificate of a section; None where it names none. ConfigError as above."""
        return None if web.cert is None or web.key is None else cls(document, web.cert, web.key)

    def context(self) -> ssl.SSLContext:
        """Return the context of a listening socket: each handshake is handed on to the newest one."""

        def use_newest(connection: ssl.SSLObject, _name: str | None, _context: ssl.SSLContext) -> None:
            connection.context = self._newest

        self._first.sni_callback = use_newest
        return self._first

    def look(self) -> None:
        """Load the files again where they changed, and return the problems.

        Invalid files change nothing.
        """
        signature = self._signature()
        if signature != self._checked or self._problem:  # the files may have been replaced only in part
            try:
                found = self._loaded()
            except PolishdError as error:
                self._problem = f"{error}. The server goes on with the certificate that it has"
            else:
                if signature != self._checked:
                    log.warning("%s: a new certificate is in use, valid until %s", self._cert, utc_minute(found[1]))
                self._newest, self._expires_s = found
                self._problem = ""
            self._checked = signature
        self._warn()

    def facts(self) -> dict[str, Any]:
        """Return until when it is valid, the days left, and what is wrong with it; for health."""
        left_s = self._expires_s - self._clock()
        return {
            "expires": utc_minute(self._expires_s),
            "days_left": round(left_s / 86400, 1),
            "wrong": "; ".join(filter(None, (self._problem, self._expiry()))),
        }

    def _expiry(self) -> str:
        left_s, expires = self._expires_s - self._clock(), utc_minute(self._expires_s)
        todo = f"Renew {self._cert} and {self._key.name}; they are taken up without a restart"
        if left_s <= 0:
            return f"the TLS certificate {self._cert} expired on {expires}: browsers and links refuse it. {todo}"
        if left_s < CERTIFICATE_WARNING_S:
            days = left_s / 86400
            return f"the TLS certificate {self._cert} expires on {expires}, in {days:.1f} days. {todo}"
        return ""

    def _warn(self) -> None:
        """Log each problem once, and again each day."""
        wrong = "; ".join(filter(None, (self._problem, self._expiry())))
        kind = f"{self._problem} {self._expires_s} {self._expires_s < self._clock()}" if wrong else ""
        last_kind, at_s = self._last_warning
        if wrong and (kind != last_kind or self._clock() - at_s >= EXPIRY_AGAIN_S):
            log.warning("%s", wrong)
            self._last_warning = (kind, self._clock())
        elif not wrong:
            self._last_warning = ("", float("-inf"))

    def _signature(self) -> tuple[tuple[int, int, int], ...]:
        found = []
        for path in (self._cert, self._key):
            try:
                stat = path.stat()
                found.append((stat.st_mtime_ns, stat.st_ino, stat.st_size))
            except OSError:
                found.append((0, 0, 0))
        return tuple(found)

    def _loaded(self) -> tuple[ssl.SSLContext, float]:
        """TLS context of the present files, and the end of the certificate's validity."""
        self._require_private_key()
        try:
            chain = x509.load_pem_x509_certificates(self._cert.read_bytes())
        except OSError as error:
            raise self._error("web.cert", self._cert, f"cannot be read: {error.strerror}") from None
        except ValueError:
            raise self._error("web.cert", self._cert, "holds no certificate") from None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        try:
            context.load_cert_chain(self._cert, self._key, password=_no_password)
        except (OSError, ValueError) as error:  # an SSLError is an OSError
            raise self._error(
                "web.key", self._key, f"is no key of {self._cert}, or needs a password ({error})"
            ) from None
        return context, min(one.not_valid_after_utc.timestamp() for one in chain)

    def _require_private_key(self) -> None:
        """ConfigError, with the key's line, where the file cannot be read or others may read it."""
        try:
            require_private(self._key)
        except OSError as error:
            raise self._error("web.key", self._key, f"cannot be read: {error.strerror}") from None
        except ConfigError as error:
            raise self._document.error("web.key", str(error)) from None

    def _error(self, key: str, path: Path, problem: str) -> ConfigError:
        named = "certificate, with those between, PEM" if key == "web.cert" else "certificate's key, PEM"
        return self._document.error(key, f"{path} {problem}. Name the {named}")


class CertificateMonitor:
    """Check a certificate in a separate thread, so that a disk that hangs blocks nothing else."""

    def __init__(self, certificate: Certificate) -> None:
        self._certificate, self._ended = certificate, threading.Event()
        threading.Thread(target=self._poll, name="certificate", daemon=True).start()

    def end(self) -> None:
        """End the thread, without waiting for it. Idempotent."""
        self._ended.set()

    def _poll(self) -> None:
        while not self._ended.is_set():
            try:
                self._certificate.look()
            except Exception:  # the thread must survive any content of the files
                log.exception("looking at the TLS certificate failed; it is looked at again")
            self._ended.wait(POLL_S)


def _no_password() -> str:
    return ""
