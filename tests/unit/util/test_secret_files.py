"""Secrets in files and in the environment: who may read them, and who does not inherit them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from polishd.model.errors import ConfigError
from polishd.util.secret_files import environment_without_secrets, read_secret, require_private
from polishd.web.http.users import Role, UserFile

OPEN = (0o640, 0o660, 0o662, 0o604, 0o606, 0o620, 0o644, 0o610)


@pytest.mark.parametrize("mode", OPEN)
def test_a_secret_that_group_or_others_may_read_or_change_is_refused_with_what_to_run(
    tmp_path: Path, mode: int
) -> None:
    path = tmp_path / "a token"
    path.write_text("s3cret\n")
    path.chmod(mode)
    run = re.escape(f"Run: chmod 600 '{path}'")
    with pytest.raises(ConfigError, match=rf"^'file:a token': mode {mode:04o} of .*{run}$") as refused:
        read_secret("file:a token", tmp_path)
    assert "s3cret" not in str(refused.value)
    path.chmod(0o600)
    assert read_secret("file:a token", tmp_path) == "s3cret"
    path.chmod(0o400)
    assert read_secret("file:a token", tmp_path) == "s3cret"


def test_what_to_run_takes_nothing_from_the_owner(tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.touch()
    path.chmod(0o440)
    with pytest.raises(ConfigError, match=r"Run: chmod 400 "):
        require_private(path)


@pytest.mark.parametrize("mode", OPEN)
def test_users_whom_others_could_add_or_read_are_refused(tmp_path: Path, mode: int) -> None:
    users = UserFile(tmp_path / "web-users.json")
    token = users.add("anna", Role.WATCH)
    users.path.chmod(mode)
    with pytest.raises(ConfigError, match=r"Run: chmod 600 "):
        users.of_token(token)
    users.path.chmod(0o600)
    assert users.of_token(token) is not None


def test_a_worker_inherits_what_it_needs_and_no_secret(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    monkeypatch.setenv("MAIL_PASSWORD", "s3cret")
    found = environment_without_secrets({"OMP_NUM_THREADS": "1"})
    assert (found["PYTHONPATH"], found["OMP_NUM_THREADS"]) == ("/somewhere", "1")
    assert "PATH" in found
    assert "s3cret" not in found.values()
