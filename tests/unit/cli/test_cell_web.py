"""``polishd web``: users are made and removed; ``polishd approve`` is for the plan that waits now."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.daemon.socket import client
from polishd.util.command_line import account_name, terminal_user
from polishd.web import routes
from polishd.web.http.users import Role, User, UserFile, users_path
from tests.unit.cli_result import Polishd


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    return write_demo(tmp_path / "demo", None, 2.0, 4, None).cell


def test_a_token_is_shown_once_and_taken_away_again(polishd: Polishd, cell: Path) -> None:
    said = polishd("web", cell, "--add-user", "anna", "--role", "operate")
    users, token = UserFile(users_path(load_config(cell))), said.out.strip()
    assert users.of_token(token) == User("anna", Role.OPERATE)
    assert token not in said.err
    assert token not in users.path.read_text()
    again = polishd("web", cell, "--add-user", "anna").out.strip()
    assert users.of_token(token) is None
    assert users.of_token(again) == User("anna", Role.WATCH)
    assert polishd("web", cell, "--remove-user", "anna").code == 0
    assert not users
    refused = polishd("web", cell, "--remove-user", "anna")
    assert (refused.code, "there is no user 'anna'" in refused.err) == (3, True)
    assert polishd("web", cell, "--add-user", "../x").code == 3


def test_an_unreadable_user_file_admits_no_user(polishd: Polishd, cell: Path) -> None:
    path = users_path(load_config(cell))
    path.parent.mkdir(exist_ok=True)
    path.write_text('{"anna": {"role": "king", "token_sha256": "00"}}')
    path.chmod(0o600)
    refused = polishd("web", cell)
    assert (refused.code, "cannot be read" in refused.err) == (3, True)


def test_it_serves(polishd: Polishd, cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    served = []
    monkeypatch.setattr(routes, "serve", served.append)
    said = polishd("web", cell)
    assert (said.code, len(served)) == (0, 1)
    assert "there are no users" in said.err


def test_approve_is_for_the_plan_that_waits_now(polishd: Polishd, cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, Any]] = []

    def request(_state_dir: Path, verb: str, args: Any = None) -> dict[str, Any]:
        asked.append((verb, args))
        return {"ok": True, "approval": "ab"}

    monkeypatch.setattr(client, "request", request)
    assert json.loads(polishd("approve", cell, "--json").out)["ok"]
    assert asked == [("live", None), ("approve", {"program_sha256": "ab", "by": terminal_user()})]


def test_an_account_of_another_computer_is_its_number() -> None:
    assert account_name(2**31 - 5) == str(2**31 - 5)
