"""A whole file: one TOML loader for a cell, a study, an instrument's profile and the simulator."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from pydantic import PrivateAttr, ValidationError

from polishd.config.places import TomlSource, validation_problems
from polishd.config.values import ConfigSection
from polishd.files import toml_text
from polishd.model.errors import ConfigError, PolishdError

MOST_LEVELS = 32
"""Of lists and tables inside one another, in a file."""


class TomlDocument(ConfigSection):
    """What all files share: where they lie, and where each of their keys stands."""

    _path: Path = PrivateAttr(default=Path("none.toml"))
    _source: TomlSource = PrivateAttr(default=TomlSource("none.toml", ""))
    _raw: Mapping[str, Any] = PrivateAttr(default_factory=dict)

    @classmethod
    def of(cls, raw: Mapping[str, Any], source: TomlSource) -> Self:
        """The values of a file; ConfigError, a line each: ``FILE:LINE: section.key: what is wrong; what to do``."""
        try:
            made = cls.model_validate(raw)
        except ValidationError as error:
            raise ConfigError("\n".join(validation_problems(error, cls, source))) from error
        made._path, made._source, made._raw = Path(source.file).absolute(), source, raw
        return made

    @property
    def source(self) -> TomlSource:
        """The text it came from: says where a key stands, for errors."""
        return self._source

    @property
    def base_dir(self) -> Path:
        """Folder that relative paths start from."""
        return self._path.parent

    def resolve(self, path: str) -> Path:
        """A path of the file, absolute."""
        return self.base_dir / Path(path).expanduser()

    def relative(self, path: Path) -> str:
        """A path as the file would name it: from its own folder."""
        return Path(os.path.relpath(path.absolute(), self.base_dir)).as_posix()

    def error(self, key: str, problem: str) -> ConfigError:
        """A ConfigError about a dotted key, with its place: for checks that need more than this file."""
        return ConfigError(self._source.error(tuple(key.split(".")), problem))

    @contextmanager
    def blame(self, key: str) -> Iterator[None]:
        """What cannot be computed in this block is the file's fault, and is said with the place of this dotted key."""
        try:
            yield
        except ConfigError:
            raise
        except PolishdError as error:
            raise self.error(key, str(error)) from error


def load_toml(path: Path) -> tuple[dict[str, Any], TomlSource]:
    """A TOML file's values, and the text that says where they stand; ConfigError with file and line."""
    return loads_toml(toml_text(path), path)


def loads_toml(text: str, path: Path) -> tuple[dict[str, Any], TomlSource]:
    """The same of a text that stood in that file."""
    try:
        raw = tomllib.loads(text)
        if deep := _too_deep(raw):
            raise ConfigError(f"{path}: {deep} is nested more than {MOST_LEVELS} levels deep; no key of polishd is")
        return raw, TomlSource(str(path), text)
    except RecursionError:
        raise ConfigError(
            f"{path}: lists or tables are nested more than {MOST_LEVELS} levels deep; no key of polishd is"
        ) from None
    except tomllib.TOMLDecodeError as error:  # which says "... (at line 3, column 5)" or "(at end of document)"
        what, _, place = str(error).partition(" (at ")
        line = place.split()[1].rstrip(",") if place.startswith("line") else str(text.count("\n") + 1)
        raise ConfigError(f"{path}:{line}: this is not TOML: {what}; mend that line") from error
    except ValueError as error:  # a whole number of more than 4300 digits, which Python does not read
        raise ConfigError(f"{path}: a value cannot be read: {error}; write a shorter one") from error


def _too_deep(raw: Mapping[str, Any]) -> str:
    """The key of the first level below which there are too many; empty where there is none."""
    level: list[tuple[str, Any]] = list(raw.items())
    for _ in range(MOST_LEVELS):
        inner = [(key, value) for key, value in level if isinstance(value, (dict, list))]
        level = [(key, item) for key, value in inner for item in (value.values() if isinstance(value, dict) else value)]
    return next((key for key, value in level if isinstance(value, (dict, list))), "")
