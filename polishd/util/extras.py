"""Extras of the installation: what each is for, its libraries, and the error where one is missing.

The keys are those of ``[project.optional-dependencies]`` in ``pyproject.toml``; ``polishd[all]`` installs every extra
but ``tail``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec

from polishd.model.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Extra:
    """An optional part of the installation."""

    purpose: str
    """What needs it."""
    libraries: Mapping[str, str]
    """Distributions, and the module that each one brings."""


EXTRAS: Mapping[str, Extra] = {
    "fast": Extra(
        "compiled code for long programs and large dwell problems", {"numba": "numba", "llvmlite": "llvmlite"}
    ),
    "studies": Extra("the table of a study's cases, polishd study --out", {"pyarrow": "pyarrow"}),
    "dask": Extra("polishd study --scheduler", {"distributed": "distributed"}),
    "fits": Extra("FITS maps", {"astropy": "astropy"}),
    "gwy": Extra("Gwyddion maps", {"gwyfile": "gwyfile"}),
    "tiff": Extra("TIFF maps", {"tifffile": "tifffile"}),
    "tail": Extra("Wyko .opd, SUR and some forty other map formats", {"SurfaceTopography": "SurfaceTopography"}),
    "metrics": Extra("GET /metrics of polishd web", {"prometheus-client": "prometheus_client"}),
    "opcua": Extra("polishd opcua, and plc_robot over OPC UA", {"asyncua": "asyncua"}),
    "ads": Extra("plc_robot over ADS", {"pyads": "pyads"}),
    "ftp": Extra("program files to a controller by FTP", {"aioftp": "aioftp"}),
    "sftp": Extra("program files to a controller by SFTP", {"asyncssh": "asyncssh"}),
    "testing": Extra(
        "polishd hil, and the suites for drivers", {"pytest": "pytest", "pytest-asyncio": "pytest_asyncio"}
    ),
}


def missing_libraries(extra: str) -> list[str]:
    """Return the distributions of an extra that are not installed."""
    return [library for library, module in EXTRAS[extra].libraries.items() if find_spec(module) is None]


def missing_message(what: str, extra: str) -> str:
    """Return the message where something needs a missing extra: libraries, extra and command."""
    missing = missing_libraries(extra) or list(EXTRAS[extra].libraries)
    is_are = "which is" if len(missing) == 1 else "which are"
    return f"{what} needs {' and '.join(missing)}, {is_are} not installed. Run: pip install 'polishd[{extra}]'"


def require_extra(what: str, extra: str) -> None:
    """Raise ConfigError with the command that installs the extra where a library of it is missing."""
    if missing_libraries(extra):
        raise ConfigError(missing_message(what, extra))
