"""Lock of a state folder, with any earlier content of its file, and with disk errors."""

from __future__ import annotations

import errno
import fcntl
import os
import re
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.runtime.exit_record import LOCK_NAME, locked
from polishd.model.errors import ConfigError


def test_whatever_it_held_before_it_holds_the_pid_alone(tmp_path: Path) -> None:
    (tmp_path / LOCK_NAME).write_text("999999999 and more\n")
    with locked(tmp_path):
        assert (tmp_path / LOCK_NAME).read_text() == f"{os.getpid()}\n"
    assert (tmp_path / LOCK_NAME).read_text() == ""


def test_it_is_its_owners_alone(tmp_path: Path) -> None:
    with locked(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b" / LOCK_NAME).stat().st_mode & 0o777 == 0o600


def test_one_that_says_nothing_of_itself_is_refused_all_the_same(tmp_path: Path) -> None:
    handle = os.open(tmp_path / LOCK_NAME, os.O_RDWR | os.O_CREAT)
    fcntl.flock(handle, fcntl.LOCK_EX)
    said = f"{tmp_path}: another polishd runs this cell (pid unknown). Stop it first (polishd stop)"
    with pytest.raises(ConfigError, match=re.escape(said)):
        locked(tmp_path).__enter__()
    os.close(handle)
    with locked(tmp_path):
        pass


@pytest.mark.parametrize("call", ["ftruncate", "pwrite"])
def test_a_disk_that_takes_no_pid_is_told_and_nothing_stays_locked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, call, full)
    said = f"{tmp_path}: the state folder cannot be used: No space left on device. Repair it, or set cell.state_dir"
    with pytest.raises(ConfigError, match=re.escape(said)):
        locked(tmp_path).__enter__()
    monkeypatch.undo()
    with locked(tmp_path):
        pass


def test_what_ends_the_work_comes_out_as_itself_and_frees_it(tmp_path: Path) -> None:
    with pytest.raises(KeyError), locked(tmp_path):
        raise KeyError
    with locked(tmp_path):
        pass


def test_the_place_that_is_wrong_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(
        ConfigError, match=re.escape(f"{tmp_path / 'file' / 'state'}: the state folder cannot be used: ")
    ):
        locked(tmp_path / "file" / "state").__enter__()


def test_a_file_that_says_what_nobody_can_read_is_held_all_the_same(tmp_path: Path) -> None:
    (tmp_path / LOCK_NAME).write_bytes(b"\xff\xfe\n")
    handle = os.open(tmp_path / LOCK_NAME, os.O_RDWR)
    fcntl.flock(handle, fcntl.LOCK_EX)
    with pytest.raises(ConfigError, match="another polishd runs this cell"):
        locked(tmp_path).__enter__()
    os.close(handle)
