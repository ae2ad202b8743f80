"""Files of a run folder that the page may show or deliver: pictures, report, certificates. No other file is read."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PICTURES = "pictures"
KINDS: Mapping[str, str] = {
    ".png": "image/png",
    ".html": "text/html; charset=utf-8",
    ".pdf": "application/pdf",
    ".json": "application/json",
}
REPORT = "report.html"
CERTIFICATE_SCHEMA = "polishd-certificate-"
MOST_BYTES = 64 << 20
"""A larger file is not delivered."""
MOST_CERTIFICATE_BYTES = 8 << 20
"""A larger JSON file is no certificate."""


@dataclass(frozen=True, slots=True)
class RunFile:
    """A file of a run folder that may be delivered."""

    name: str
    path: Path
    size: int
    """Bytes."""

    @property
    def media_type(self) -> str:
        """Type by the ending."""
        return KINDS[self.path.suffix]

    @property
    def is_picture(self) -> bool:
        """The page shows it; other files are for download."""
        return self.path.suffix == ".png"

    def content(self) -> bytes | None:
        """Return the bytes; None where it is no regular file any more, is too large, or cannot be read."""
        try:
            number = os.open(self.path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        except OSError:
            return None
        with os.fdopen(number, "rb") as file:
            found = os.fstat(number)
            if not stat.S_ISREG(found.st_mode) or found.st_size > MOST_BYTES:
                return None
            return file.read(MOST_BYTES)


class RunFiles:
    """The files of one run folder that may be delivered. Symbolic links and other names are not followed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def facts(self) -> dict[str, Any]:
        """Return the folder, whether it is there, and its pictures, report and certificates."""
        files = self.files()
        report = files.get(REPORT)
        return {
            "folder": str(self._folder),
            "present": self._folder.is_dir(),
            "pictures": [name for name, one in files.items() if one.is_picture],
            "report": None if report is None else REPORT,
            "certificates": list(self._certificates(files)),
        }

    def file(self, name: str) -> RunFile | None:
        """Return the file of that name; None where there is none that may be delivered."""
        found = self.files()
        one = found.get(name)
        if one is None or one.is_picture or name == REPORT:
            return one
        certified = {each for facts in self._certificates(found) for each in (facts["pdf"], facts["json"])}
        return one if name in certified else None

    def files(self) -> dict[str, RunFile]:
        """Return the candidates by name."""
        found = {one.name: one for one in _regular(self._folder) if one.path.suffix in {".pdf", ".json"}}
        found |= {one.name: one for one in _regular(self._folder) if one.name == REPORT}
        return found | {one.name: one for one in _regular(self._folder / PICTURES) if one.is_picture}

    def _certificates(self, files: Mapping[str, RunFile]) -> Iterator[dict[str, Any]]:
        for name, one in files.items():
            pdf = files.get(str(Path(name).with_suffix(".pdf")))
            if one.path.suffix != ".json" or pdf is None or one.size > MOST_CERTIFICATE_BYTES:
                continue
            if (certificate := _certificate(one)) is not None:
                yield {"pdf": pdf.name, "json": name, "bytes": pdf.size, **certificate}


def _certificate(file: RunFile) -> dict[str, Any] | None:
    """Return number, date, verdict and key of a certificate; None where the file is none."""
    try:
        content = file.content()
        found = {} if content is None else json.loads(content)
        if not str(found["schema"]).startswith(CERTIFICATE_SCHEMA):
            return None
        signature = found["seal"]["signature"]
        return {
            "number": str(found["number"]),
            "issued": str(found["issued"]),
            "verdict": str(found["verdict"]["words"]),
            "signed": None if signature is None else str(signature["key_id"]),
        }
    except (ValueError, LookupError, TypeError, RecursionError):
        return None


def _regular(folder: Path) -> Iterator[RunFile]:
    """Yield the regular files of a folder; none where it cannot be read, or is a symbolic link."""
    try:
        if folder.name == PICTURES and folder.is_symlink():
            return
        with os.scandir(folder) as entries:
            for entry in sorted(entries, key=lambda one: one.name):
                if entry.is_file(follow_symlinks=False) and Path(entry.name).suffix in KINDS:
                    yield RunFile(entry.name, Path(entry.path), entry.stat(follow_symlinks=False).st_size)
    except OSError:
        return
