"""What mail and webhooks share: how long a step may take, whom to trust, and where a secret may go in the clear."""

from __future__ import annotations

import ssl
from pathlib import Path

from polishd.api import ConfigError

STEP_S = 15.0
"""Longest that a server may leave unanswered: a connection, or one command."""
LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
"""A secret in the clear stays on this computer."""


def trusting(ca_file: str | None, base_dir: Path) -> ssl.SSLContext:
    """Who is believed: the system's authorities, or those of that file. ConfigError, which quotes it."""
    try:
        return ssl.create_default_context(cafile=None if ca_file is None else base_dir / Path(ca_file).expanduser())
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(f"{ca_file!r}: cannot be read: {error}; name a file of certificates (PEM)") from error
