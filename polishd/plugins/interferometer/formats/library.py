"""Reading through somebody else's library: whatever it raises on a broken file is a BadMap."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from polishd.api import BadMap


@contextmanager
def parsing(path: Path, library: str) -> Iterator[None]:
    """Turn everything that the library raises in this block into BadMap; its warnings go unheard.

    What a warning would be about (lengths, units, checksums) the readers check themselves.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except BadMap:
        raise
    except Exception as error:  # a parser may raise anything at all on a broken file
        reason = str(error).strip() or type(error).__name__
        raise BadMap(f"{path}: {library} cannot read it: {reason[:300]}") from error


def extra(path: Path, module: str, name: str) -> Any:
    """The module of an optional extra; BadMap with the command that installs it where it is not there."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise BadMap(f"{path}: needs the extra: pip install 'polishd[{name}]' ({error})") from error
