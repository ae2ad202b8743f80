"""The file that LinuxCNC runs: the program's blocks, with places to stand and words that tell how far it is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from polishd.api import DeviceRefused
from polishd.drivers.transport import program_file
from polishd.files import write_atomic


class LinuxCncProgramFile(program_file.ProgramFile):
    """Blocks with a pause (``M0``) before each of ``stops``, and a message before each pause and the program's end.

    Run from line would lose G61/G64 and what else is queued; behind a pause all modal state is kept. linuxcncrsh shows
    no line of a block that does not move, and the same state for our pause and an operator's: hence the messages.
    """

    def __init__(self, blocks: Sequence[bytes], stops: Iterable[int], token: str) -> None:
        self._token = token
        super().__init__(
            blocks, stops, lambda stop: [self._message(stop) + b" M0"], lambda _: [self._message(len(blocks))]
        )

    def reached(self, message: str) -> int | None:
        """Number of blocks that are executed by this operator message; None where it is none of ours."""
        words = message.split()
        if len(words) == 3 and words[:2] == ["polishd", self._token] and words[2].isdecimal():
            return int(words[2])
        return None

    def write(self, folder: Path, name: str) -> Path:
        """Put it there whole: temp, fsync, rename. DeviceRefused where that fails."""
        path = folder / name
        try:
            write_atomic(path, self.text)  # readable by all: LinuxCNC may be another user
        except OSError as error:
            raise DeviceRefused(f"{path}: {error.strerror or error}. To do: look at [robot] program_dir") from error
        return path

    def _message(self, executed: int) -> bytes:
        return f"(MSG,polishd {self._token} {executed})".encode()
