"""Large arrays beside the journal, by the hash of their content: the journal's rows name them by it."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polishd.files import make_folder, write_atomic
from polishd.model.errors import ConfigError, SafetyStop
from polishd.recipe.encoding import Arrays, npz


class ArrayStore:
    """Files ``<sha256>.npz`` in one folder, each written whole and never changed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def put(self, arrays: Arrays | bytes) -> str:
        """Keep arrays, or their ``.npz``; its hash, once it is durable. SafetyStop where the disk will not have it."""
        content = arrays if isinstance(arrays, bytes) else npz(arrays)
        sha256 = hashlib.sha256(content).hexdigest()
        try:
            make_folder(self.folder)
            write_atomic(self._path(sha256), content, mode=0o600)
        except OSError as error:
            raise SafetyStop(
                f"journal: {self._path(sha256)}: cannot be written: {error.strerror}; polishing without a record is "
                "refused: mend the disk, then start polishd again"
            ) from error
        return sha256

    def content(self, sha256: str) -> bytes:
        """The file that has this hash; ConfigError where it is gone, or is not what the journal names."""
        path = self._path(sha256)
        try:
            content = path.read_bytes()
        except OSError as error:
            raise ConfigError(_lost(path, f"cannot be read: {error.strerror}")) from error
        if hashlib.sha256(content).hexdigest() != sha256:
            raise ConfigError(_lost(path, "is not what the journal names: its content has another hash"))
        return content

    def get(self, sha256: str) -> dict[str, NDArray[Any]]:
        """The arrays that ``put`` gave this hash."""
        with np.load(io.BytesIO(self.content(sha256)), allow_pickle=False) as archive:
            return dict(archive)

    def remove(self, *names: str) -> None:
        """Remove what nobody will ask for again; what is not there is no error."""
        for name in filter(None, names):
            self._path(name).unlink(missing_ok=True)

    def _path(self, sha256: str) -> Path:
        return self.folder / f"{sha256}.npz"


def _lost(path: Path, problem: str) -> str:
    return f"{path}: {problem}; the job cannot go on without it: restore the file, or give job.id a new name"
