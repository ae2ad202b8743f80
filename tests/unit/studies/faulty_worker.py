"""Worker of studies that behaves as a case's point requests."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any

from polishd.model.errors import ConfigError
from polishd.studies.cases import versions
from polishd.util.array_stream import Message
from polishd.util.worker_main import AnswerFunction


def start() -> tuple[dict[str, Any], AnswerFunction]:
    return {"versions": dict(versions())}, answer


def start_with_other_versions() -> tuple[dict[str, Any], AnswerFunction]:
    return {"versions": {**versions(), "scipy": "0.1"}}, answer


def start_in_vain() -> tuple[dict[str, Any], AnswerFunction]:
    raise ModuleNotFoundError("nothing of the kind")


def answer(request: dict[str, Any], _: dict[str, Any]) -> Message:
    """Answer, fail, hang, or die; "once" in the point: at the first try only."""
    case, what = request["case"], str(request["case"]["at"].get("what", ""))
    if what.startswith("once"):
        tried = Path(request["study"]).with_name(f"tried-{case['number']}")
        what = "" if tried.exists() else what.removeprefix("once ")
        tried.touch()
    if what == "dies":
        sys.stderr.write("out of luck\n")
        sys.stderr.flush()
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "hangs":
        signal.pause()
    if what == "refuses":
        raise ConfigError("files differ")
    failed = "ValueError: no" if what == "raises" else ""
    rows = [] if failed else [{"rms_nm": case["number"] / 3}]
    return {"rows": rows, "failed": failed, "wall_s": 0.01, "cpu_s": 0.01}, {}
