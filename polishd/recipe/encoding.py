"""What a record is made of, arrays and facts, and both as the bytes of a file."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from polishd.model.errors import ConfigError
from polishd.model.printable import printable

Arrays = Mapping[str, NDArray[Any] | float]
T = TypeVar("T")
ROWS = 4096
"""Of a table, that are written at once."""


def arrays_of(record: Any) -> dict[str, NDArray[Any]]:
    """The arrays of a dataclass, by field."""
    return {name: value for name, value in _values(record).items() if isinstance(value, np.ndarray)}


def facts_of(record: Any) -> dict[str, Any]:
    """Its other fields, as JSON holds them but for tuples."""
    return {
        name: asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
        for name, value in _values(record).items()
        if not isinstance(value, np.ndarray)
    }


def record_of(cls: type[T], facts: Mapping[str, Any], arrays: Mapping[str, Any] = MappingProxyType({})) -> T:
    """The dataclass that ``facts_of`` and ``arrays_of`` took apart, also from JSON; what it has no field for is left.

    ConfigError where a field is missing, or a fact of another type: another polishd, or another plugin, wrote it.
    """
    hints = get_type_hints(cls)
    try:
        found = {name: TypeAdapter(hints[name]).validate_python(fact) for name, fact in facts.items() if name in hints}
        return cls(**found, **{name: value for name, value in arrays.items() if name in hints})
    except (TypeError, ValidationError) as error:
        problem = str(error).replace("\n", " ")
        raise ConfigError(
            f"what was kept as {cls.__name__} cannot be read: {problem}; finish the job with the polishd and the "
            "plugins that wrote it, or give job.id a new name"
        ) from error


def npz(arrays: Arrays) -> bytes:
    """Named arrays as one compressed .npz."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **{key: np.asarray(value) for key, value in arrays.items()})
    return buffer.getvalue()


def table(columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Return columns as CSV with a header line; floats with nine significant digits."""
    found = [np.asarray(column, dtype=np.float64) for column in columns.values()]
    row = ",".join(["%.9g"] * len(found)) + "\n"
    buffer = io.BytesIO()
    buffer.write((printable(",".join(columns)) + "\n").encode())
    for first in range(0, len(found[0]) if found else 0, ROWS):  # numbers as Python's objects a piece at a time
        numbers = np.column_stack([column[first : first + ROWS] for column in found])
        buffer.write((row * len(numbers) % tuple(numbers.ravel().tolist())).encode())
    return buffer.getvalue()


def as_json(content: Any) -> bytes:
    """A JSON object, or a dataclass as one. TypeError for what is neither."""
    plain = asdict(content) if is_dataclass(content) and not isinstance(content, type) else content
    return (json.dumps(plain, indent=2, default=_plain) + "\n").encode()


def _values(record: Any) -> dict[str, Any]:
    return {item.name: getattr(record, item.name) for item in fields(record)}


def _plain(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"not JSON: {type(value).__name__}")
