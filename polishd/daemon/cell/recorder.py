"""``--record``: write the messages on a cell's links to a file, in a thread, so that no device waits for the disk."""

from __future__ import annotations

import contextlib
import gzip
import logging
import queue
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import copy_context
from datetime import UTC, datetime
from itertools import chain, count
from pathlib import Path
from typing import IO

from polishd import __version__
from polishd.config.cell import CellConfig
from polishd.model.errors import ConfigError
from polishd.util.wire_recording import WireMessage, header_line, note_line, passed_line, record_received

log = logging.getLogger(__name__)

LONGEST = 20_000
"""Largest number of records that wait for the disk; further ones are dropped, counted and logged."""
LIMIT = 100_000_000
"""Largest size of a file in bytes, enough for hours."""
FLUSH_S = 1.0
"""Interval of the flushes: the longest time that a power cut loses."""
ENDING = ".wire.jsonl.gz"


def place(where: Path, config: CellConfig) -> Path:
    """Return the file of that cell: ``where``, or a new one in the folder ``where``; ConfigError if it exists."""
    if not where.is_dir():
        if where.exists():
            raise ConfigError(f"--record {where}: exists already. Name another file or a folder")
        return where
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    name = re.sub(r"[^\w.-]+", "_", config.cell.name)
    names = (f"{name}-{stamp}{which}{ENDING}" for which in chain([""], (f"-{number}" for number in count(2))))
    return next(path for path in map(where.joinpath, names) if not path.exists())


@contextmanager
def recording_to(path: Path, config: CellConfig, limit: int = LIMIT) -> Iterator[None]:
    """Record all links that are opened in this block or by tasks that begin in it.

    ConfigError if the file cannot be created. A later write error goes to the log, and the cell goes on.
    """
    try:
        file = path.open("xb")
    except OSError as error:
        raise ConfigError(f"--record {path}: {error.strerror or error}. Name a writable file") from error
    writer = _Writer(path, file, limit)
    writer.start(config)
    try:
        with record_received(writer.add):
            yield
    finally:
        writer.stop()


class _Writer:
    """Queue and thread of one file; the thread closes the file."""

    def __init__(self, path: Path, file: IO[bytes], limit: int) -> None:
        self._path, self._raw, self._limit = path, file, limit
        self._file = gzip.GzipFile(fileobj=file, mode="wb", compresslevel=3, filename="")
        self._waiting: queue.Queue[WireMessage | None] = queue.Queue(LONGEST)
        self._lost = 0
        self._over = False
        """Nothing more is written: the file is full or the disk failed."""
        self._began_s = time.monotonic()
        self._thread = threading.Thread(target=copy_context().run, args=(self._write,), name="record", daemon=True)

    def start(self, config: CellConfig) -> None:
        devices = {
            name: {"type": str(section.type), "link": str(getattr(section, "address", "")).partition(":")[0]}
            for name, section in config.devices.items()
        }
        began = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._file.write(header_line(__version__, config.cell.name, began, devices))
        self._thread.start()

    def add(self, one: WireMessage) -> None:
        """Queue a message; drop and count it if the queue is full."""
        if self._over:
            return
        try:
            self._waiting.put_nowait(one)
        except queue.Full:
            self._lost += 1

    def stop(self) -> None:
        """Write all queued messages; abandon a disk or a thread that hangs."""
        with contextlib.suppress(queue.Full):
            self._waiting.put(None, timeout=FLUSH_S)
        self._thread.join(5 * FLUSH_S)

    def _write(self) -> None:
        try:
            with self._raw, self._file:
                self._write_until_stopped()
        except OSError as error:
            log.error("%s: %s: the recording ends here", self._path, error.strerror or error)
        finally:
            self._over = True

    def _write_until_stopped(self) -> None:
        reported, flushed_s = 0, time.monotonic()
        while True:
            try:
                one = self._waiting.get(timeout=FLUSH_S)
            except queue.Empty:
                self._file.flush()
                continue
            if (lost := self._lost) > reported:
                at_s = time.monotonic() if one is None else one.at_s
                self._file.write(note_line(at_s - self._began_s, "lost", lost - reported))
                log.warning(
                    "%s: %d records were dropped: its disk is slower than the links", self._path, lost - reported
                )
                reported = lost
            if one is None:
                return
            self._file.write(passed_line(one, self._began_s))
            if self._raw.tell() > self._limit:
                self._file.write(note_line(one.at_s - self._began_s, "full", self._limit))
                log.warning("%s: reached its limit of %d bytes; nothing more is recorded", self._path, self._limit)
                return
            if time.monotonic() - flushed_s > FLUSH_S:
                self._file.flush()
                flushed_s = time.monotonic()
