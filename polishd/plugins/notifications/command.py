"""A command of the shop's own: a notification as JSON on its standard input."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import Annotated

from pydantic import Field

from polishd.api import ConfigError, LinkError, Notification
from polishd.config.values import ConfigSection

OUTPUT_BYTES = 500
"""As much of the end of its standard error is told."""


class CommandOptions(ConfigSection):
    """Keys of ``[notify.NAME]`` with ``type = "command"``."""

    argv: Annotated[list[str], Field(min_length=1)]
    """The program and its arguments; no shell reads them. It starts in the folder of the cell's file, from where a
    program with a slash in its name is looked for."""
    within_s: Annotated[float, Field(gt=0, le=50)] = 30.0
    """Longest that it may run; then it is killed, with what it started."""


class Command:
    """Runs the command; anything but exit code 0 is a failure."""

    def __init__(self, options: CommandOptions, base_dir: Path) -> None:
        program = options.argv[0]
        path = str(base_dir / Path(program).expanduser()) if "/" in program else program
        found = shutil.which(path)
        if found is None:
            raise ConfigError(f"{program!r}: there is no such program that may be run; mend argv")
        self._argv = [found, *options.argv[1:]]
        self._within_s, self._base_dir = options.within_s, base_dir

    def __call__(self, notification: Notification) -> None:
        """Run it to its end; LinkError where it fails, or is killed.

        Files, not pipes: whatever it leaves running cannot keep anybody waiting, nor can one that does not read.
        """
        with tempfile.TemporaryFile() as given, tempfile.TemporaryFile() as said:
            given.write(json.dumps(notification.facts()).encode() + b"\n")
            given.seek(0)
            process = subprocess.Popen(
                self._argv, stdin=given, stdout=subprocess.DEVNULL, stderr=said, cwd=self._base_dir, process_group=0
            )
            try:
                code = process.wait(self._within_s)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                raise LinkError(f"{self._argv[0]}: was killed after {self._within_s:g} s") from None
            if code:
                said.seek(max(said.seek(0, os.SEEK_END) - OUTPUT_BYTES, 0))
                words = " ".join(said.read().decode("utf-8", "replace").split())
                raise LinkError(f"{self._argv[0]}: ended with {code}: {words}".rstrip(": "))
