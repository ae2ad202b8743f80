"""The page's files: every file in ``static``, by its exact path; compressed once, and not sent again unchanged."""

from __future__ import annotations

import gzip
import hashlib
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from types import MappingProxyType

from starlette.requests import Request
from starlette.responses import Response

MEDIA_TYPES: Mapping[str, str] = MappingProxyType(
    {
        "html": "text/html; charset=utf-8",
        "css": "text/css; charset=utf-8",
        "js": "text/javascript; charset=utf-8",
        "svg": "image/svg+xml",
        "png": "image/png",
        "woff2": "font/woff2",
        "webmanifest": "application/manifest+json",
    }
)
"""By suffix. A file of another suffix is not served: licence texts, for example."""
COMPRESSED = frozenset({"html", "css", "js", "svg", "webmanifest"})
"""Suffixes of text, which gzip reduces to a third."""
INDEX = "index.html"


class StaticFile:
    """One file. ``content`` is read at construction: later changes on disk are not served."""

    def __init__(self, suffix: str, content: bytes) -> None:
        self.content = content
        self._media_type = MEDIA_TYPES[suffix]
        self._is_text = suffix in COMPRESSED
        self._gzipped: bytes | None = None
        self._tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'

    async def answer(self, request: Request) -> Response:
        """Return the file, or 304 to a client that has it: browsers ask each time, and are never a version behind."""
        headers = {"etag": self._tag, "cache-control": "no-cache", "vary": "accept-encoding"}
        if self._tag in request.headers.get("if-none-match", ""):
            return Response(status_code=304, headers=headers)
        body = self.content
        if self._is_text and "gzip" in request.headers.get("accept-encoding", ""):
            body = self.sent
            headers["content-encoding"] = "gzip"
        return Response(body, headers={**headers, "content-type": self._media_type})

    @property
    def sent(self) -> bytes:
        """Its bytes as a browser gets them."""
        return self.gzipped() if self._is_text else self.content

    def gzipped(self) -> bytes:
        """Return the compressed file; the same bytes at each call and in each process."""
        if self._gzipped is None:
            self._gzipped = gzip.compress(self.content, 6, mtime=0)
        return self._gzipped


def static_files() -> dict[str, StaticFile]:
    """All files of the page by request path; no other path is served, so none can leave the folder."""
    found = dict(_below(resources.files("polishd.web") / "static", ""))
    found["/"] = found.pop(f"/{INDEX}")
    return found


def _below(folder: Traversable, path: str) -> list[tuple[str, StaticFile]]:
    found: list[tuple[str, StaticFile]] = []
    for entry in folder.iterdir():
        suffix = entry.name.rpartition(".")[2]
        if entry.is_dir():
            found += _below(entry, f"{path}/{entry.name}")
        elif suffix in MEDIA_TYPES:
            found.append((f"{path}/{entry.name}", StaticFile(suffix, entry.read_bytes())))
    return found
