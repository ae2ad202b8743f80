"""Errors of the command line for programs: a JSON object on stdout with ``--json``, beside the text on stderr."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path, PurePath
from typing import Any

from polishd.model.errors import ConfigError, PlanRefused, PluginError, PolishdError, ProgramError, SurfaceError
from polishd.rendering import terminal

_OF_FILES = (ConfigError, PlanRefused, PluginError, ProgramError, SurfaceError)
"""Errors about files. Messages of others may begin with ``HOST:PORT:``, which is no file and line."""
_LOCATION = re.compile(r"^(?P<file>[^\n:]+):(?P<line>\d+): (?:(?P<key>[A-Za-z_]\w*(?:\.[\w-]+)*): )?", re.MULTILINE)
"""``FILE:LINE: key: `` at the begin of a line, as ``TomlSource.error`` writes it."""
_PROGRAM_LINE = re.compile(r"^(?P<file>[^\n:]+), line (?P<line>\d+): ", re.MULTILINE)
"""``FILE, line LINE: `` at the begin of a line, as readers of programs write it."""
_FILE = re.compile(r"(?P<file>[^\n:]+?)(?:, row \d+ [^\n:]*)?: ")
"""``FILE: `` or ``FILE, row ROW is ...: `` at the begin of a message; other messages begin with a key or a device."""


def error_facts(error: Exception, message: str, exit_code: int) -> dict[str, Any]:
    """Return message, name and exit code of an error; file, line and key where they are known."""
    facts = {"ok": False, "error": message, "code": type(error).__name__, "exit_code": exit_code}
    if isinstance(error, OSError):
        return facts | ({"file": str(error.filename)} if error.filename else {})
    return facts | (_location(message, isinstance(error, ConfigError)) if isinstance(error, _OF_FILES) else {})


def _location(message: str, has_key: bool) -> dict[str, Any]:
    """Return file, line and key of a message about a file, as far as it states them."""
    if (found := _LOCATION.search(message) or _PROGRAM_LINE.search(message)) is not None:
        key = found.groupdict().get("key")
        return {"file": found["file"], "line": int(found["line"])} | ({"key": key} if key and has_key else {})
    if (found := _FILE.match(message)) is not None and _names_file(found["file"]):
        return {"file": found["file"]}
    return {}


def _names_file(name: str) -> bool:
    """Whether the begin of a message is a path: one of the command line, an absolute one, or an existing file."""
    given = {word.rpartition("=")[2] for word in sys.argv[1:]}
    if name in given or name in {PurePath(word).name for word in given}:
        return True
    with suppress(OSError, ValueError):
        return not name.endswith(" (override)") and (name.startswith("/") or Path(name).is_file())
    return False


def print_json_error(error: Exception, message: str, exit_code: int) -> None:
    """Print the error on stdout if ``--json`` was given, unless the command's own JSON object was printed before."""
    if "--json" in sys.argv[1:] and not terminal.json_output.is_printed:
        terminal.emit(error_facts(error, message, exit_code), as_json=True)


def refusal_of(reply: Mapping[str, Any]) -> PolishdError:
    """Return the error of a daemon's reply that is not ok, with its exit code."""
    error = PolishdError(reply["error"])
    error.exit_code = reply.get("exit_code", error.exit_code)
    return error
