"""Functions compiled by numba, and where what was compiled is kept.

Compiled code is kept in the user's cache, in a folder named after its sources, so that no change of them meets code of
before (numba itself looks at the file of the function alone, not at those of what it calls).
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import Any


def has_compiler() -> bool:
    """Return whether numba is installed (extra ``fast``); numpy and the interpreter give the same figures without."""
    return find_spec("numba") is not None


def compile_cached(function: Callable[..., Any], sources: Iterable[Path], **options: Any) -> Callable[..., Any]:
    """The function by numba, kept with others of the same sources, which are the files of all that it calls."""
    import numba

    settings: Any = numba.config
    folder = _folder(numba.__version__, tuple(sources))
    before, settings.CACHE_DIR = settings.CACHE_DIR, folder or ""
    try:
        njit: Any = numba.njit(cache=folder is not None, nogil=True, **no_refcount_option(), **options)
        made: Callable[..., Any] = njit(function)
    finally:
        settings.CACHE_DIR = before
    return made


def no_refcount_option() -> dict[str, Any]:
    """The option by which compiled code counts no references; nothing where this numba has none.

    Nothing that is compiled here allocates, and counting a dozen arrays at every call takes forty times the time (a
    whole program is read in seven times the time). The option is numba's own and not in its manual; a numba without it
    compiles the same code to the same numbers. What it offers instead (inlining by its own means or LLVM's) is as slow.
    """
    from numba.core import options

    return {"_nrt": False} if hasattr(getattr(options, "DefaultOptions", None), "_nrt") else {}


def _folder(version: str, sources: tuple[Path, ...]) -> str | None:
    """Return the cache folder of compiled code; None without a home: each process then compiles."""
    digest = hashlib.sha256(version.encode())
    for source in sorted(sources):
        digest.update(source.read_bytes())
    try:
        folder = cache_folder() / digest.hexdigest()[:16]
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, RuntimeError):  # the account has no home
        return None
    return str(folder)


def cache_folder() -> Path:
    """Return the folder of all compiled code of this user. RuntimeError where the account has no home."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "polishd"
