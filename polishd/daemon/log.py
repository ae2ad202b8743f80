"""The structured log of a cell: one JSON object a line in its state folder, for machines; times are UTC."""

from __future__ import annotations

import json
import logging
import logging.handlers
import queue
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from pathlib import Path

from polishd.model.printable import printable
from polishd.plain import plain

LOG_NAME = "polishd.log"
_MAX_BYTES = 10_000_000
_KEPT = 5
_cell: ContextVar[Path | None] = ContextVar("cell", default=None)
"""The state folder of the cell at work."""


class JsonLines(logging.Formatter):
    """``{"at", "level", "logger", "message"}``, with ``event`` of an event and ``error`` of an exception."""

    def format(self, record: logging.LogRecord) -> str:
        """One line."""
        line: dict[str, object] = {
            "at": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if hasattr(record, "event"):
            line["event"] = record.event
        if record.exc_info:
            line["error"] = self.formatException(record.exc_info)
        return printable(json.dumps(line, default=plain))


@contextmanager
def logging_to(state_dir: Path) -> Iterator[None]:
    """What polishd logs of a cell goes to ``state_dir/polishd.log`` (rotated) inside this block.

    Of a cell is what is logged in this context: by the tasks and threads that begin in the block. What belongs to no
    cell is in the log of each. A thread writes it: who logs in contact does not wait for the disk.
    """
    file = logging.handlers.RotatingFileHandler(
        state_dir / LOG_NAME, maxBytes=_MAX_BYTES, backupCount=_KEPT, encoding="utf-8"
    )
    lines: queue.SimpleQueue[logging.LogRecord] = queue.SimpleQueue()
    handler = logging.handlers.QueueHandler(lines)
    handler.setFormatter(JsonLines())  # here, as things are now; what is queued is the line
    handler.addFilter(lambda _: _cell.get() in {None, state_dir})
    _cell.set(state_dir)
    writer = logging.handlers.QueueListener(lines, file)
    writer.start()
    logger = logging.getLogger("polishd")
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        if not logger.handlers:  # else another cell still logs
            logger.setLevel(logging.NOTSET)
        writer.stop()
        file.close()
