"""A webhook: HTTP POST, to a program of the shop's own or to a chat."""

from __future__ import annotations

import json
from collections.abc import Mapping
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import SplitResult, urlsplit

from pydantic import AfterValidator

from polishd.api import ConfigError, LinkError, Notification, SecretPlace, Severity, hide, read_secret
from polishd.config.values import ConfigSection
from polishd.plugins.notifications.tls import LOOPBACK, STEP_S, trusting

NTFY_PRIORITY: Mapping[Severity, str] = {Severity.INFO: "2", Severity.WARNING: "4", Severity.ALARM: "5"}
REPLY_BYTES = 200
"""As much of a refusal is told."""


def _url_or_place(text: str) -> str:
    """What it is made of is not repeated: it may be secret."""
    if not text.startswith(("file:", "env:")):
        _parsed(text)
    return text


def _parsed(url: str) -> SplitResult:
    wrong = 'is no URL; write it as "https://host/path", or where it is kept: "file:NAME", "env:VARIABLE"'
    try:
        parts = urlsplit(url)
        whole = parts.scheme in {"http", "https"} and parts.hostname and parts.port != 0
    except ValueError:
        raise ValueError(wrong) from None
    if not whole or not url.isascii() or not url.isprintable() or " " in url:
        raise ValueError(wrong)
    if parts.username or parts.password:
        raise ValueError('a password does not stand in a config; use token = "file:NAME"')
    return parts


class WebhookOptions(ConfigSection):
    """Keys of ``[notify.NAME]`` with ``type = "webhook"``."""

    url: Annotated[str, AfterValidator(_url_or_place)]
    """Where it is posted to; or where that is kept, `file:NAME` or `env:VARIABLE`, since who knows the address of a
    chat's hook may write there."""
    format: Literal["json", "slack", "ntfy"] = "json"
    """What is posted: all fields of a notification; `{"text": ...}` as Slack, Mattermost and Rocket.Chat take it; or
    plain text, title and priority for ntfy."""
    token: SecretPlace | None = None
    """Where a token is kept that is sent as `Authorization: Bearer`: `file:NAME` or `env:VARIABLE`."""
    ca_file: str | None = None
    """Certificates to trust instead of the system's, PEM: for a server of the house."""


class Webhook:
    """Posts a notification; anything but an answer of 200 to 299 is a failure. No proxy, no redirection."""

    def __init__(self, options: WebhookOptions, base_dir: Path) -> None:
        self._options, self._base_dir = options, base_dir
        self._context = trusting(options.ca_file, base_dir)
        self._address()
        if options.token:
            read_secret(options.token, base_dir)

    def __call__(self, notification: Notification) -> None:
        """Post it; LinkError where that is not accepted. It names the host, not the rest of the URL."""
        parts = self._address()
        token = read_secret(self._options.token, self._base_dir) if self._options.token else ""
        path = parts._replace(scheme="", netloc="", fragment="").geturl() or "/"
        headers, body = self._content(notification)
        headers |= {"Authorization": f"Bearer {token}"} if token else {}
        try:
            self._post(parts, path, headers, body)
        except (OSError, HTTPException, ValueError) as error:
            secrets = (token, *(part for part in (parts.path, parts.query) if len(part) > 1))
            raise LinkError(hide(f"{parts.scheme}://{parts.netloc}: {error}", *secrets)) from None

    def _address(self) -> SplitResult:
        """ConfigError, which quotes the key's value where that is a place."""
        url = self._options.url
        try:
            parts = _parsed(read_secret(url, self._base_dir) if url.startswith(("file:", "env:")) else url)
        except ValueError as error:
            raise ConfigError(f"{url!r}: what is kept there {error}") from None
        if self._options.token and parts.scheme == "http" and parts.hostname not in LOOPBACK:
            raise ConfigError(f"{self._options.token!r}: a token is not sent in the clear; use an https:// address")
        return parts

    def _content(self, notification: Notification) -> tuple[dict[str, str], bytes]:
        match self._options.format:
            case "ntfy":
                title = notification.title.encode("ascii", "replace").decode()
                headers = {"Title": title, "Priority": NTFY_PRIORITY[notification.severity]}
                return headers, notification.text.encode()
            case "slack":
                facts = {"text": f"*{notification.title}*\n{notification.text}"}
            case _:
                facts = notification.facts()
        return {"Content-Type": "application/json"}, json.dumps(facts).encode()

    def _post(self, parts: SplitResult, path: str, headers: Mapping[str, str], body: bytes) -> None:
        host = str(parts.hostname)
        if parts.scheme == "https":
            connection: HTTPConnection = HTTPSConnection(host, parts.port, timeout=STEP_S, context=self._context)
        else:
            connection = HTTPConnection(host, parts.port, timeout=STEP_S)
        try:
            connection.request("POST", path, body, dict(headers))
            with connection.getresponse() as answer:
                said = " ".join(answer.read(REPLY_BYTES).decode("utf-8", "replace").split())
            if not 200 <= answer.status <= 299:
                raise HTTPException(f"answered {answer.status} {answer.reason}: {said}".rstrip(": "))
        finally:
            connection.close()
