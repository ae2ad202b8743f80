"""The run folder: what a job leaves behind for people. The journal, not this folder, is what the daemon trusts."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polishd.files import write_atomic
from polishd.recipe.arrays import Arrays, npz


class RunFolder:
    """Files of one job; each is written whole. Layout: docs/run-folder.md."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def create(self) -> None:
        """Make the folder, with its parents; whoever writes does, for a person may have deleted it meanwhile."""
        self.path.mkdir(parents=True, exist_ok=True)

    def cycle(self, cycle: int) -> RunFolder:
        """The subfolder of one cycle."""
        return RunFolder(self.path / f"cycle-{cycle:02d}")

    def holds(self, name: str) -> bool:
        """Whether the file is there."""
        return (self.path / name).exists()

    def bytes(self, name: str, content: bytes) -> None:
        """A file as it is."""
        self.create()
        write_atomic(self.path / name, content)

    def copy(self, source: Path, name: str) -> None:
        """A copy of a file elsewhere."""
        self.create()
        partial = self.path / f".{name}.partial"
        shutil.copyfile(source, partial)
        partial.rename(self.path / name)

    def json(self, name: str, content: Any) -> None:
        """A JSON object, or a dataclass as one."""
        plain = asdict(content) if is_dataclass(content) and not isinstance(content, type) else content
        self.bytes(name, (json.dumps(plain, indent=2, default=_plain) + "\n").encode())

    def arrays(self, name: str, arrays: Arrays) -> None:
        """Named arrays in one compressed .npz."""
        self.bytes(name, npz(arrays))

    def table(self, name: str, columns: Mapping[str, NDArray[Any]]) -> None:
        """Columns as CSV with a header line; floats with nine significant digits."""
        rows = np.column_stack([np.asarray(column, dtype=np.float64) for column in columns.values()])
        buffer = io.StringIO()
        np.savetxt(buffer, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
        self.bytes(name, buffer.getvalue().encode())


def _plain(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"not JSON: {type(value).__name__}")
