"""Errors of the command line for programs: a JSON object on stdout with ``--json``, beside the text on stderr."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from typing import Any

from polishd.model.errors import ConfigError, PlanRefused, PluginError, PolishdError, ProgramError, SurfaceError
from polishd.rendering import terminal

_OF_FILES = (ConfigError, PlanRefused, PluginError, ProgramError, SurfaceError)
"""Errors about files. Messages of others may begin with ``HOST:PORT:``, which is no file and line."""
_LOCATION = re.compile(r"^(?P<file>[^\n:]+):(?P<line>\d+): (?:(?P<key>[A-Za-z_]\w*(?:\.[\w-]+)*): )?", re.MULTILINE)
"""``FILE:LINE: key: `` at the begin of a line, as ``TomlSource.error`` writes it."""


def error_facts(error: Exception, message: str, exit_code: int) -> dict[str, Any]:
    """Return message, name and exit code of an error; file, line and key where its message begins with them."""
    facts = {"ok": False, "error": message, "code": type(error).__name__, "exit_code": exit_code}
    if isinstance(error, _OF_FILES) and (found := _LOCATION.search(message)) is not None:
        facts |= {"file": found["file"], "line": int(found["line"])}
        facts |= {"key": found["key"]} if found["key"] and isinstance(error, ConfigError) else {}
    return facts


def print_json_error(error: Exception, message: str, exit_code: int) -> None:
    """Print the error on stdout if ``--json`` was given, unless the command's own JSON object was printed before."""
    if "--json" in sys.argv[1:] and not terminal.json_output.is_printed:
        terminal.emit(error_facts(error, message, exit_code), as_json=True)


def refusal_of(reply: Mapping[str, Any]) -> PolishdError:
    """Return the error of a daemon's reply that is not ok, with its exit code."""
    error = PolishdError(reply["error"])
    error.exit_code = reply.get("exit_code", error.exit_code)
    return error
