"""``python -m polishd.studies.worker_process``: cases on stdin, their rows on stdout, a line each, until the end.

A process of its own, so that a case that hangs or kills it takes nothing else along. What is printed goes to stderr.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from pathlib import Path
from typing import Any, TextIO

from polishd.model.errors import ConfigError, PolishdError
from polishd.plugins.rnc_robot.gcode import jit
from polishd.studies.case_runner import CaseRunner
from polishd.studies.cases import Case, versions
from polishd.util.serialization import plain


def serve(requests: TextIO, answers: TextIO) -> None:
    """Say ready, then answer each request: ``rows``, or ``failed`` with why, or ``refused``."""
    bench, begun = None, ""
    _say(answers, {"ready": versions()})
    for line in requests:
        request = json.loads(line)
        try:
            if bench is None or begun != request["run"]:
                if bench is not None:
                    bench.close()
                bench, begun = CaseRunner(Path(request["study"])), request["run"]
            case = Case(**request["case"])
            bench.require_same(case)
        except ConfigError as error:
            _say(answers, {"refused": str(error)})
        else:
            _say(answers, _answer(bench, case))
    if bench is not None:
        bench.close()


def _answer(bench: CaseRunner, case: Case) -> dict[str, Any]:
    wall, cpu = time.monotonic(), time.process_time()
    try:
        answer: dict[str, Any] = {"rows": bench.rows(case)}
    except PolishdError as error:
        answer = {"failed": f"{type(error).__name__}: {error}"}
    except Exception as error:  # noqa: BLE001  whatever it was, it is this case's, and is told
        answer = {"failed": "".join(traceback.format_exception_only(error)).strip()}
        traceback.print_exc()
    return {**answer, "wall_s": time.monotonic() - wall, "cpu_s": time.process_time() - cpu}


def _say(answers: TextIO, what: dict[str, Any]) -> None:
    answers.write(json.dumps(what, default=plain) + "\n")
    answers.flush()


if __name__ == "__main__":
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as out:
        os.dup2(2, 1)  # what a library prints is no answer
        jit.compile_always()
        serve(sys.stdin, out)
