"""The long tail of formats (Wyko .opd, SUR and some forty others) through SurfaceTopography, in a process of its own.

It pulls in 38 packages and parses whatever it is given, so none of it is imported here: a worker with bounds on its
memory and time reads the file and hands back numbers, and what goes wrong there is a BadMap here.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from polishd.api import BadMap, SurfaceMap, SurfaceReader
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.common import MOST_SAMPLES, content_of, sha256_of
from polishd.plugins.interferometer.formats.scales import NO_PITCH, Pitch, checked, height_unit, pitch

NAME = "tail"
VERSION = 1
WORKER = Path(__file__).with_name("tail_worker.py")
WITHIN_S = 120.0
MEMORY_BYTES = 3 * 2**30
"""Of address space: the library's own imports take 1 GiB of it."""
MEMORY_PER_BYTE = 16
FORMATS = (
    "al3d:al3d bcr:bcr bcrf:bcr ezd:ezd frt:frt ibw:ibw jpk:jpk lext:lext mdt:mdt mi:mi mnt:mnt nc:nc nid:ezd nms:nms "
    "oir:oir opd:opd opdx:opdx os3d:os3d plu:plu plux:plux poir:poir qep:qep apx:plu spm:di sur:sur tmd:tmd "
    "vk3:vk vk4:vk vk6:vk vk7:vk zmg:zmg zon:zon"
)
FORMAT_OF = {f".{suffix}": name for suffix, name in (pair.split(":") for pair in FORMATS.split())}
"""SurfaceTopography's reader by a file's ending: only that one is tried."""
SUFFIXES = tuple(FORMAT_OF)
OPTICAL_PATH = {".opd", ".zmg"}
"""Interferometers' own: what stands there may be a wavefront."""


def sniff(head: bytes, path: Path) -> bool:  # noqa: ARG001  the formats have no magic number in common
    """True for the endings of formats that no other reader knows."""
    return path.suffix.lower() in SUFFIXES


def read(path: Path) -> SurfaceMap:
    """Read the file's default channel. BadMap without the extra, and for whatever the worker could not read in time."""
    if not sniff(b"", path):
        raise BadMap(f"{path}: {path.suffix or 'no suffix'} is none of the formats read through SurfaceTopography")
    content = content_of(path)
    sha256 = sha256_of(content)
    head, body = _answer(path, _run(path, len(content)))
    if head.get("sha256") != sha256:
        raise BadMap(f"{path}: changed while it was read")
    height_nm = _heights(path, head, body)
    height = height_unit("nm" if head["unit"] is not None else "")
    lateral = _pitch(path, head)
    unsaid = height.unsaid | lateral.unsaid | {"orientation"}
    several = (f"the default one of {head['channels']} channels is taken",) if head.get("channels", 1) > 1 else ()
    return SurfaceMap(
        height_nm=height_nm,
        pitch_mm=lateral.mm,
        instrument=str(head.get("instrument", "")),
        taken_at=_time(str(head.get("taken_at", ""))),
        sha256=sha256,
        path=path,
        format=f"{NAME}:{head.get('format', '')}",
        factors={"unit": head["unit"], "read_by": "SurfaceTopography"},
        warnings=height.warnings + lateral.warnings + several,
        unsaid=unsaid | ({"surface"} if path.suffix.lower() in OPTICAL_PATH else set()),
        orientation="as stored, transposed from SurfaceTopography's [x, y]; its formats differ in their first row",
        reader_version=VERSION,
    )


def _run(path: Path, length: int) -> bytes:
    """The worker's standard output."""
    limits = (str(MEMORY_BYTES + MEMORY_PER_BYTE * length), str(math.ceil(WITHIN_S) + 1))
    # -P: the worker's folder, whose modules have everyday names, stays off its path
    command = [sys.executable, "-P", str(WORKER), str(path.absolute()), FORMAT_OF[path.suffix.lower()], *limits]
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=WITHIN_S,
            check=False,
            env=os.environ | threads,
        )
    except subprocess.TimeoutExpired as error:
        raise BadMap(f"{path}: SurfaceTopography did not read it within {WITHIN_S:g} s") from error
    except OSError as error:
        raise BadMap(f"{path}: no process to read it in: {error.strerror}") from error
    if done.returncode != 0:
        said = done.stderr.decode("utf-8", "replace").strip().splitlines()[-1:]
        raise BadMap(f"{path}: the process that reads it ended with {done.returncode}: {''.join(said)[:300]}")
    return done.stdout


def _answer(path: Path, output: bytes) -> tuple[dict[str, Any], memoryview]:
    """The header of the worker's answer, and the bytes after it."""
    line = output[: output.find(b"\n") + 1]
    try:
        head = json.loads(line)
    except ValueError as error:
        raise BadMap(f"{path}: the process that reads it gave no answer") from error
    if "missing" in head:
        raise BadMap(f"{path}: needs the extra: pip install 'polishd[tail]' (no module {head['missing']})")
    if "error" in head:
        raise BadMap(f"{path}: SurfaceTopography cannot read it: {head['error']}")
    return head, memoryview(output)[len(line) :]


def _heights(path: Path, head: dict[str, Any], body: memoryview) -> FloatArray:
    rows, columns = head["rows"], head["columns"]
    if min(rows, columns) < 2 or rows * columns > MOST_SAMPLES or len(body) != 8 * rows * columns:
        raise BadMap(f"{path}: {rows} x {columns} samples in {len(body)} bytes of answer: no map")
    return checked(path, np.frombuffer(body, dtype="<f8").reshape(rows, columns).astype(np.float64))


def _pitch(path: Path, head: dict[str, Any]) -> Pitch:
    if "pitch_nm" not in head:
        return NO_PITCH
    x_nm, y_nm = head["pitch_nm"]
    return pitch(path, x_nm / 1e6, y_nm / 1e6)


def _time(text: str) -> datetime | None:
    try:
        taken = datetime.fromisoformat(text)
    except ValueError:
        return None
    return taken if taken.tzinfo else taken.replace(tzinfo=UTC)


TAIL = SurfaceReader(name=NAME, sniff=sniff, read=read, suffixes=SUFFIXES)
