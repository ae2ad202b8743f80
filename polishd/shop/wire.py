"""Requests of a cell to its shop: HTTP by its token, over TLS, or on this computer."""

from __future__ import annotations

import json
import ssl
from collections.abc import Mapping
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from polishd.config.shop_link import ShopLinkSection
from polishd.model.errors import ConfigError, LinkError
from polishd.secret import hide, read_secret

STEP_S = 15.0
"""Longest that the shop may leave a step unanswered."""
MOST_BYTES = 32 << 20
SERVER_ERRORS = 500


class Wire:
    """One request after the other; each on a connection of its own. No proxy, no redirection."""

    def __init__(self, section: ShopLinkSection, base_dir: Path) -> None:
        """ConfigError where there is no token, or whom to trust cannot be read."""
        self._section, self._base_dir = section, base_dir
        ca_file = None if section.ca_file is None else base_dir / Path(section.ca_file).expanduser()
        try:
            self._context = ssl.create_default_context(cafile=ca_file)
        except (OSError, ssl.SSLError) as error:
            raise ConfigError(f"{ca_file}: cannot be read: {error}; name a file of certificates (PEM)") from error
        read_secret(section.token, base_dir)

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
        """The same, as it came."""
        token = read_secret(self._section.token, self._base_dir)
        try:
            status, content = self._post(path, json.dumps(dict(said)).encode(), token)
        except (OSError, HTTPException, ValueError) as error:
            raise LinkError(hide(f"{self._section.url}: {type(error).__name__}: {error}", token)) from None
        if status == 200:
            return content
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
            headers = {"Content-Type": "application/json", "Authorization": f"Bearer {token}"}
            connection.request("POST", path, body, headers)
            with connection.getresponse() as answer:
                content = answer.read(MOST_BYTES)
                if not answer.isclosed():
                    raise HTTPException(f"its answer is more than {MOST_BYTES} bytes")
                return answer.status, content
        finally:
            connection.close()


def _error(content: bytes) -> str:
    try:
        return str(json.loads(content)["error"])[:500]
    except (ValueError, KeyError, TypeError):
        return " ".join(content[:200].decode("utf-8", "replace").split())
