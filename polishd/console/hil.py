"""``polishd hil``: says what will move, asks, and runs the ports' suites on the devices of a real cell."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
from importlib.resources import files
from pathlib import Path

import typer

from polishd.daemon.lock import locked
from polishd.model.errors import ConfigError, DeviceFault, PolishdError
from polishd.show.tables import record_table, stdout

INI = "[pytest]\nasyncio_default_fixture_loop_scope = function\nfilterwarnings = default\n"
KEPT, BROKEN, INTERRUPTED, REFUSED = 0, 1, 2, 4
"""Exit codes of pytest."""


def hil_verb(
    cell: Path, level: str, max_force_n: float | None, simulate: str, motion: Path | None, *, yes: bool
) -> None:
    """DeviceFault where a demand is not kept; ConfigError where nothing was tried."""
    if importlib.util.find_spec("pytest") is None or importlib.util.find_spec("pytest_asyncio") is None:
        raise ConfigError("polishd hil needs pytest: pip install 'polishd[testing]'; nothing was opened")
    from polishd.testing.bench import SUITES, Asked, Level, foreseen

    names = tuple(filter(None, simulate.split(",")))
    asked = Asked(cell=cell, level=Level.of(level), max_force_n=max_force_n, simulate=names, motion=motion)
    seen = foreseen(asked)
    title, columns = f"{seen.config.cell.name}: level {level}", ("device", "what it is", "what happens to it")
    stdout.print(record_table(title, columns, seen.does()))
    with locked(seen.config.state_dir):
        _ask(yes=yes)
    options = ["--cell", str(cell.resolve()), "--hil-level", level, "--hil-simulate", simulate]
    options += [] if max_force_n is None else ["--hil-max-force", str(max_force_n)]
    options += [] if motion is None else ["--hil-motion", str(motion.resolve())]
    _judge(_run([f"{suite}.py" for suite in SUITES], options))


def _ask(*, yes: bool) -> None:
    if yes:
        return
    if not sys.stdin.isatty():
        raise ConfigError("nobody is there to ask; --yes goes on without asking. Nothing was opened")
    if not typer.confirm("Keep clear, and a hand on the emergency stop. Go on?"):
        raise typer.Exit(1)


def _run(suites: list[str], options: list[str]) -> int:
    """The exit code of pytest, as a process of its own: whatever project the person stands in has no say there."""
    folder = Path(str(files("polishd.testing") / "suites"))
    with tempfile.TemporaryDirectory(prefix="polishd-hil-") as scratch:
        ini = Path(scratch) / "pytest.ini"
        ini.write_text(INI)
        how = ["-c", str(ini), "--rootdir", str(folder), "--import-mode=importlib", "-p", "no:cacheprovider"]
        show = ["-v", "--no-header", "--tb=short", "-rs"]
        command = [sys.executable, "-P", "-m", "pytest", *how, *show, *options, *suites]
        with subprocess.Popen(command, cwd=folder) as process:
            while True:
                try:
                    return process.wait()
                except KeyboardInterrupt:
                    continue  # it has heard it, too, and makes the device safe that it has open


def _judge(code: int) -> None:
    """What an exit code of pytest means here."""
    if code == KEPT:
        return
    if code == BROKEN:
        raise DeviceFault("a device does not do what its port demands: see above; docs/drivers.md has the ports")
    if code == INTERRUPTED:
        raise typer.Exit(130)
    if code == REFUSED:
        raise ConfigError("nothing was opened: see above")
    raise PolishdError(f"the suites could not be run: pytest ended with {code}, see above")
