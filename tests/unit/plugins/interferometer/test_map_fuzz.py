"""Broken files of every format, read through the plugin's readers: a map or MapError, within limits of memory.

The bound on Python's and NumPy's memory is 4 times the file and a floor of 4 MiB (libraries' tables, parsers' stacks);
what libraries allocate in C shows in the process' high-water mark, which a whole part may raise by 96 MiB at most.
"""

from __future__ import annotations

import resource
import sys
import time
import zlib
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from polishd.api import MapError, SurfaceMap, SurfaceReader
from polishd.plugins.interferometer import READERS, formats
from tests.memory import peak_bytes
from tests.unit.plugins.interferometer import map_files, map_files_other
from tests.unit.plugins.interferometer.map_mutations import mutated

FLOOR_BYTES = 4 * 2**20
C_FLOOR_KIB = 96 * 2**10
MOST_CPU_S = 5.0
QUICK = 200
PARTS = 10
LONG = 100_000 // PARTS

SUFFIX = {reader.name: reader.suffixes[0] for reader in READERS if reader.suffixes}
EXAMPLES = {name: (f"map{SUFFIX.get(name, '')}", content()) for name, content in map_files.EXAMPLES.items()}
EXAMPLES |= map_files_other.EXAMPLES | {"4d-4sight": ("map.h5", map_files.foursight())}
VARIANTS: dict[str, list[tuple[str, bytes]]] = {reader.name: [] for reader in READERS if reader.name != "tail"}
"""Names and contents of valid files by reader; the tail's parsers run in a process of their own."""
for file_name, valid in EXAMPLES.values():
    claimed = [reader.name for reader in READERS if reader.sniff(valid[:4096], Path(file_name))]
    VARIANTS[claimed[0]].append((file_name, valid))


def read_broken(reader: SurfaceReader, path: Path) -> SurfaceMap | None:
    """Return the map, or None where the reader raises MapError; anything else fails."""
    began = time.process_time()
    try:
        surface = reader.read(path)
    except MapError as error:
        assert str(path) in str(error)  # noqa: PT017  the message names the file
        surface = None
    assert time.process_time() - began < MOST_CPU_S
    if surface is not None:
        assert surface.height_nm.ndim == 2
        assert surface.height_nm.dtype == np.float64
        assert np.isfinite(surface.height_nm).any()
        assert not np.isinf(surface.height_nm).any()
        assert surface.pitch_mm is None or 0 < surface.pitch_mm < np.inf
    return surface


def fuzz(name: str, part: int, count: int, folder: Path, measure_every: int) -> int:
    """Read damaged files of a format and return how many of them are still maps."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), part])
    reader = next(reader for reader in READERS if reader.name == name)
    for file_name, valid in VARIANTS[name]:  # what is imported and cached once is not counted
        (folder / file_name).write_bytes(valid)
        assert read_broken(reader, folder / file_name) is not None
    high_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    maps = 0
    for number in range(count):
        file_name, valid = VARIANTS[name][number % len(VARIANTS[name])]
        content = mutated(valid, rng)
        path = folder / file_name
        path.write_bytes(content)
        found: list[SurfaceMap | None] = []
        read = partial(lambda path, found: found.append(read_broken(reader, path)), path, found)
        try:
            if number % measure_every == 0:
                most = 4 * len(content) + FLOOR_BYTES
                assert peak_bytes(read, most) <= most
            else:
                read()
            maps += found[0] is not None
        except BaseException:
            Path(f"{folder}-{name}-{part}-{number}").write_bytes(content)  # to look at
            raise
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - high_kib < C_FLOOR_KIB
    return maps


def test_every_reader_is_fuzzed() -> None:
    assert all(VARIANTS.values()), {name for name, files in VARIANTS.items() if not files}


@pytest.mark.parametrize("name", VARIANTS)
def test_more_samples_than_a_camera_has_are_refused(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in list(sys.modules.values()):
        if module.__name__.startswith(formats.__name__) and hasattr(module, "MOST_SAMPLES"):
            monkeypatch.setattr(module, "MOST_SAMPLES", 5)
    read = next(reader.read for reader in READERS if reader.name == name)
    if isinstance(read, partial):  # in the worker, which has the limit as it was
        read = import_module(read.args[0]).parse
    for file_name, valid in VARIANTS[name]:
        path = tmp_path / file_name
        path.write_bytes(valid)
        with pytest.raises(MapError, match=r"no interferometer's camera|samples"):
            read(path)


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", VARIANTS)
def test_broken_files_are_maps_or_refused(name: str, tmp_path: Path) -> None:
    maps = fuzz(name, PARTS, QUICK, tmp_path, measure_every=2)
    assert maps < QUICK  # else nothing was broken


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("name", VARIANTS)
def test_a_hundred_thousand_broken_files(name: str, part: int, tmp_path: Path) -> None:
    fuzz(name, part, LONG, tmp_path, measure_every=10)
