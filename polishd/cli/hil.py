"""``polishd hil``: list the motions, confirm, and run the ports' test suites on the devices of a real cell."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from importlib.resources import files
from pathlib import Path
from typing import Any, TextIO
from xml.etree import ElementTree as ET

import typer

from polishd.daemon.runtime.exit_record import locked
from polishd.model.errors import ConfigError, DeviceFault, PolishdError
from polishd.rendering.terminal import emit, record_table, stderr, stdout
from polishd.util.extras import require_extra

INI = "[pytest]\nasyncio_default_fixture_loop_scope = function\nfilterwarnings = default\n"
PASSED, FAILED, INTERRUPTED, USAGE_ERROR = 0, 1, 2, 4
"""Exit codes of pytest."""


def hil_verb(
    cell: Path,
    level: str,
    max_force_n: float | None,
    simulate: str,
    motion: Path | None,
    *,
    record: Path | None,
    yes: bool,
    as_json: bool,
) -> None:
    """Run the suites; raise DeviceFault if a requirement fails, ConfigError if nothing was tested.

    With ``as_json`` text for people goes to stderr.
    """
    require_extra("polishd hil", "testing")
    from polishd.testing.hil_bench import SUITES, HilRequest, Level, foreseen

    names = tuple(filter(None, simulate.split(",")))
    of = Level.of(level)
    request = HilRequest(cell=cell, level=of, max_force_n=max_force_n, simulate=names, motion=motion, record=record)
    forecast = foreseen(request)
    title, columns = f"{forecast.config.cell.name}: level {level}", ("device", "what it is", "what happens to it")
    does = list(forecast.does())
    (stderr if as_json else stdout).print(record_table(title, columns, does))
    with locked(forecast.config.state_dir):
        _confirm(yes=yes)
    options = ["--cell", str(cell.resolve()), "--hil-level", level, "--hil-simulate", simulate]
    options += [] if max_force_n is None else ["--hil-max-force", str(max_force_n)]
    options += [] if motion is None else ["--hil-motion", str(motion.resolve())]
    options += [] if record is None else ["--hil-record", str(record.resolve())]
    code, found = _run([f"{suite}.py" for suite in SUITES], options, out=sys.stderr if as_json else None)
    if as_json:
        devices = [dict(zip(("device", "what", "does"), row, strict=True)) for row in does]
        emit({"cell": forecast.config.cell.name, "level": level, "devices": devices, **found}, as_json=True, table=str)
    _judge(code)


def _confirm(*, yes: bool) -> None:
    if yes:
        return
    if not sys.stdin.isatty():
        raise ConfigError("no terminal for the confirmation; use --yes to continue without it. Nothing was opened")
    if not typer.confirm("Keep clear, and a hand on the emergency stop. Go on?", err=True):
        raise typer.Exit(1)


def _run(suites: list[str], options: list[str], out: TextIO | None) -> tuple[int, dict[str, Any]]:
    """Run pytest, independent of the project in the current folder, and return its exit code and results."""
    folder = Path(str(files("polishd.testing") / "suites"))
    with tempfile.TemporaryDirectory(prefix="polishd-hil-") as scratch:
        ini = Path(scratch) / "pytest.ini"
        ini.write_text(INI)
        how = ["-c", str(ini), "--rootdir", str(folder), "--import-mode=importlib", "-p", "no:cacheprovider"]
        show = ["-v", "--no-header", "--tb=short", "-rs"]
        report = Path(scratch) / "report.xml"
        command = [sys.executable, "-P", "-m", "pytest", *how, *show, f"--junitxml={report}", *options, *suites]
        with subprocess.Popen(command, cwd=folder, stdout=out) as process:
            while True:
                try:
                    return process.wait(), _found(report)
                except KeyboardInterrupt:
                    continue  # pytest receives the signal, too, and makes the open device safe


def _found(report: Path) -> dict[str, Any]:
    """Count requirements that are met, not met and skipped, and list those that are not met with the reason."""
    tests = list(ET.parse(report).iter("testcase")) if report.exists() else []  # noqa: S314 - our own
    broken = {
        test.attrib["name"]: wrong.attrib.get("message", "")
        for test in tests
        for wrong in test
        if wrong.tag in ("failure", "error")
    }
    skipped = sum(test.find("skipped") is not None for test in tests)
    problems = [{"demand": name, "why": why} for name, why in broken.items()]
    return {"kept": len(tests) - len(broken) - skipped, "broken": len(broken), "skipped": skipped, "problems": problems}


def _judge(code: int) -> None:
    """Turn an exit code of pytest into an error."""
    if code == PASSED:
        return
    if code == FAILED:
        raise DeviceFault("a device does not meet the requirements of its port: see above and docs/how-to/drivers.md")
    if code == INTERRUPTED:
        raise typer.Exit(130)
    if code == USAGE_ERROR:
        raise ConfigError("nothing was opened: see above")
    raise PolishdError(f"the suites could not be run: pytest ended with {code}, see above")
