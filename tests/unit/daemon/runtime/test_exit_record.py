"""One daemon per state folder."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from polishd.daemon.runtime.exit_record import locked
from polishd.model.errors import ConfigError

HOLDER = """
import sys
from pathlib import Path
from polishd.daemon.runtime.exit_record import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def holder(state_dir: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", HOLDER, str(state_dir)]
    process = subprocess.Popen(command, stdin=-1, stdout=-1, text=True, env=environment)
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def test_second_daemon_is_refused_by_pid_and_crash_frees(tmp_path: Path) -> None:
    with holder(tmp_path / "state") as process:
        with pytest.raises(ConfigError, match=rf"another polishd runs this cell \(pid {process.pid}\)"):
            locked(tmp_path / "state").__enter__()
        process.send_signal(signal.SIGKILL)
        process.wait()
        with locked(tmp_path / "state"):
            assert (tmp_path / "state" / "lock").read_text() == f"{os.getpid()}\n"


def test_lock_is_given_back_and_its_folder_private(tmp_path: Path) -> None:
    state = tmp_path / "deep" / "state"
    for _ in range(2):
        with locked(state), pytest.raises(ConfigError, match="Stop it first"), locked(state):
            pytest.fail("two daemons")
    assert state.stat().st_mode & 0o777 == 0o700
    assert (state / "lock").read_text() == ""


def test_refused_daemon_does_not_take_the_name_away(tmp_path: Path) -> None:
    with locked(tmp_path):
        for _ in range(2):
            with pytest.raises(ConfigError, match=f"pid {os.getpid()}"):
                locked(tmp_path).__enter__()


def test_unusable_folder_is_a_config_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="the state folder cannot be used"):
        locked(tmp_path / "file").__enter__()
