"""``polishd shop`` at the office: tokens, parts, releases, and what people and programs are shown."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from polishd.cli.app import app
from polishd.config.server_sections import load_shop
from polishd.model.errors import ConfigError
from polishd.shop import database as feed
from polishd.shop import parts
from polishd.shop.database import CellReport, Database
from polishd.shop.server import cells_of, users_of


class Office:
    def __init__(self, folder: Path) -> None:
        self.folder, self.file = folder, folder / "shop.toml"
        self.file.write_text('[shop]\nname = "office"\nstate_dir = "state"\n')

    def say(self, verb: str, *words: str) -> str:
        done = CliRunner().invoke(app, ["shop", verb, str(self.file), *words])
        if done.exception and not isinstance(done.exception, SystemExit):
            raise done.exception
        assert done.exit_code == 0, done.output
        return done.stdout

    def printed(self, verb: str, *words: str) -> Any:
        return json.loads(self.say(verb, *words, "--json"))

    def job(self, name: str) -> str:
        path = self.folder / f"{name}.toml"
        path.write_text(f'[job]\nid = "{name}"\n[part]\nid = "P-{name}"\n')
        return str(path)

    def database(self) -> Database:
        return Database.open(self.folder / "state")


@pytest.fixture
def office(tmp_path: Path) -> Office:
    return Office(tmp_path)


def test_tokens_are_shown_once_and_ended(office: Office) -> None:
    shop = load_shop(office.file)
    token = office.say("serve", "--add-cell", "north").strip()
    user = cells_of(shop).of_token(token)
    assert user is not None
    assert user.name == "north"
    person = office.say("serve", "--add-user", "ada", "--role", "operate").strip()
    assert users_of(shop).of_token(person) is not None
    assert cells_of(shop).of_token(person) is None
    office.say("serve", "--remove-cell", "north")
    office.say("serve", "--remove-user", "ada")
    assert cells_of(shop).of_token(token) is users_of(shop).of_token(person) is None


@pytest.mark.full
def test_parts_are_added_all_or_none_listed_released_and_removed(office: Office) -> None:
    added = office.printed("add", office.job("a"), office.job("b"), "--by", "ada")
    assert [(one["job"], one["state"], one["by"]) for one in added["parts"]] == [
        ("a", "waiting", "ada"),
        ("b", "waiting", "ada"),
    ]
    with pytest.raises(ConfigError, match="'a' is waiting in this shop already"):
        office.say("add", office.job("c"), office.job("a"))
    with office.database() as database, database.transaction() as sql:
        parts.claim(sql, "north", "r1")
    assert "north is asked to give it back" in office.say("release", "a", "--by", "ada")
    listed = office.say("list")
    assert "ada requested it back from north" in listed
    assert "a waits again" in office.say("release", "a", "--by", "ada", "--cell-is-gone")
    assert "b was removed from the shop" in office.say("remove", "b", "--by", "ada", "--reason", "broken")
    assert [one["state"] for one in office.printed("list")["parts"]] == ["waiting", "removed"]
    assert office.printed("list")["words"][-1]["why"] == "broken"


def test_times_have_their_zone(office: Office) -> None:
    office.say("add", office.job("lens"))
    assert re.search(r"\d\d:\d\d UTC", office.say("list"))


@pytest.mark.full
def test_what_cells_do_did_and_have_learned_is_shown(office: Office) -> None:
    report = CellReport(
        journal="J", first=1, last=1, before="", tail="h", now={"state": "polishing", "job": "lens", "reason": ""},
        events=[[1, 1, 5.0, None, "state", "{}"]],
        jobs=[[1, "lens", "P-1", 5.0, 9.0, "in_tolerance", None]],
        passes=[[1, 0, "ab", 6.0, 7.0, "done", "{}"]],
        maps=[[1, 0, 5.5, '{"rms_nm": 18.25}'], [1, 1, 8.0, '{"rms_nm": 1.5}']],
        lessons=[["0123456789abcdef", "lens", 0, 7.0, "bonnet 7", 0.873, 0.004]],
    )  # fmt: skip
    with office.database() as database, database.transaction() as sql:
        feed.take(sql, "north", report)
    (cell,) = office.printed("status")["cells"]
    assert (cell["cell"], cell["state"], cell["job"], cell["passes"], cell["away"]) == (
        "north", "polishing", "lens", 1, False,
    )  # fmt: skip
    assert "18.25 -> 1.50" in office.say("history")
    assert "in tolerance" in office.say("history")
    assert "0.873" in office.say("estimates")
    assert "polishing" in office.say("status")


def test_a_shops_file_that_is_wrong_is_refused_by_line(office: Office) -> None:
    office.file.write_text('[shop]\nname = "office"\nstate = "x"\n')
    with pytest.raises(ConfigError, match=r"(?s)shop\.state_dir.*shop\.toml:3: shop\.state: unknown key|shop\.state:"):
        office.say("list")


def test_a_cell_without_a_shop_has_no_link(tmp_path: Path) -> None:
    from polishd.commissioning.rehearsal.simulated_cell import write_demo

    cell = write_demo(tmp_path / "demo", None, 2.0, 4, None).cell
    done = CliRunner().invoke(app, ["shop", "connect", str(cell)])
    assert isinstance(done.exception, ConfigError)
    assert "shop: is missing; add [shop]" in str(done.exception)
