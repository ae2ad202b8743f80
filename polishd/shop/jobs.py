"""A job's file as the shop keeps it: whole with the files that it names, so that a cell needs nothing else."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from polishd.config.job_file import JobFile
from polishd.config.places import join_words
from polishd.model.errors import ConfigError
from polishd.shop.parts import NewPart

MOST_BYTES = 8 << 20
"""Of a job's files together: a report or an answer stays small enough to be read at once."""
FLAT = re.compile(r"[\w][\w.-]{0,199}", re.ASCII)


def read_part(path: Path) -> NewPart:
    """The job of a file, with its files. ConfigError where it is none, or where one of them cannot be read."""
    file = JobFile.read(path)
    fragment, _ = file.fragment()
    document = tomlkit.parse(file.text)
    files: dict[str, bytes] = {}
    for key, named in file.named(fragment):
        several = isinstance(named, list)
        flat = [_taken(files, Path(one), f"{path}: {key}") for one in (named if several else [named])]
        _put(document, key.split("."), flat if several else flat[0])
    if sum(map(len, files.values())) > MOST_BYTES:
        raise ConfigError(f"{path}: its files are more than {MOST_BYTES >> 20} MiB; let the cells' own files name them")
    return NewPart(str(fragment["job"]["id"]), str(fragment["part"]["id"]), tomlkit.dumps(document), files)


def part_of(content: str, files: Mapping[str, bytes]) -> NewPart:
    """The same of a program that brings both. ConfigError, also where it names a file that is not among them."""
    file = JobFile(Path("/") / "job.toml", content)
    fragment, source = file.fragment()
    wanted = {one for _, named in file.named(fragment) for one in (named if isinstance(named, list) else [named])}
    known = {f"/{name}" for name in files}
    if any(not FLAT.fullmatch(name) for name in files) or wanted != known:
        came = f"its files are {join_words(sorted(wanted))}, and with it came {join_words(sorted(known))}"
        raise ConfigError(f"{source.file}: {came}; send each, by a name without folders")
    return NewPart(str(fragment["job"]["id"]), str(fragment["part"]["id"]), content, files)


def digests(part: NewPart) -> dict[str, str]:
    """SHA-256 of its files, by name."""
    return {name: hashlib.sha256(content).hexdigest() for name, content in part.files.items()}


def _taken(files: dict[str, bytes], path: Path, where: str) -> str:
    """Read it; its name beside the others, where two folders have one of the same."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{where}: {path}: cannot be read: {error.strerror}; name a file") from error
    name = re.sub(r"[^A-Za-z0-9_.-]", "_", path.name).lstrip(".-") or "file"
    if files.get(name, content) != content:
        name = f"{hashlib.sha256(content).hexdigest()[:12]}-{name}"
    files[name] = content
    return name


def _put(document: Any, keys: list[str], value: Any) -> None:
    *tables, last = keys
    for table in tables:
        document = document[table]
    document[last] = value
