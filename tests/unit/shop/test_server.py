"""The shop's API: who may what, what is refused, and a cell's requests from its report to a part's files."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from polishd.config.server_sections import ShopFile, load_shop
from polishd.model.errors import ConfigError
from polishd.shop.database import Database
from polishd.shop.server import application, cells_of, serve, users_of
from polishd.web.http.server import BUDGET, WRONG
from polishd.web.http.users import Role
from tests.unit.cli_result import Polishd

REPORT = {
    "journal": "J", "first": 1, "last": 1, "before": "", "tail": "h1", "now": {"state": "idle"},
    "events": [[1, 0, 5.0, None, "state", "{}"]],
}  # fmt: skip
JOB = '[job]\nid = "lens"\n[part]\nid = "P-1"\n[program]\npath = "lens.rnc"\n'
SERVED = ("report", "claim", "refuse", "file")


def write_shop(folder: Path, web: str = "") -> ShopFile:
    (folder / "shop.toml").write_text(f'[shop]\nname = "office"\nstate_dir = "state"\n[web]\n{web}')
    return load_shop(folder / "shop.toml")


class Asked:
    """The application, and a token of each kind."""

    def __init__(self, shop: ShopFile, client: TestClient) -> None:
        self._client = client
        self.tokens = {
            "north": cells_of(shop).add("north", Role.WATCH),
            "south": cells_of(shop).add("south", Role.WATCH),
            "ada": users_of(shop).add("ada", Role.OPERATE),
            "bob": users_of(shop).add("bob", Role.WATCH),
            "": "",
            "wrong": "x" * 43,
        }

    def ask(self, who: str, method: str, path: str, said: Any = None, **headers: str) -> Any:
        token = {"authorization": f"Bearer {self.tokens[who]}"} if who else {}
        content = said if isinstance(said, bytes) else None if said is None else json.dumps(said).encode()
        return self._client.request(method, f"/api/{path}", content=content, headers={**token, **headers})

    def cell(self, who: str, path: str, said: Any) -> Any:
        found = self.ask(who, "POST", f"cell/{path}", said)
        assert found.status_code == 200, found.text
        return found.json()


@pytest.fixture
def shop(tmp_path: Path) -> Iterator[Asked]:
    file = write_shop(tmp_path)
    with Database.open(file.state_dir) as database:
        client = TestClient(application(file, database), base_url="http://127.0.0.1:8760")
        yield Asked(file, client)


def added(shop: Asked) -> None:
    files = {"lens.rnc": base64.b64encode(b"N1 G1").decode()}
    assert shop.ask("ada", "POST", "add", {"content": JOB, "files": files}).json() == {"ok": True, "added": "lens"}


def test_a_part_from_the_office_to_a_cell_with_its_program(shop: Asked) -> None:
    added(shop)
    given = shop.cell("north", "claim", {"request": "r1"})
    part = given["part"]
    assert (part["job"], part["part_id"], part["content"]) == ("lens", "P-1", JOB)
    found = shop.ask("north", "POST", "cell/file", {"sha256": part["files"]["lens.rnc"]})
    assert found.content == b"N1 G1"
    assert shop.cell("south", "claim", {"request": "r2"}) == {"ok": True, "part": None}
    answer = shop.cell("north", "report", {**REPORT, "claims": {"r1": {"state": "under way"}}})
    assert (answer["upto"], answer["stands"], answer["back"], answer["lost"]) == (1, ["r1"], [], [])
    assert shop.ask("ada", "POST", "release", {"job": "lens"}).status_code == 400
    assert "asked" not in shop.ask("bob", "GET", "parts").json()["parts"][0]
    gone = shop.ask("ada", "POST", "release", {"job": "lens", "cell_is_gone": True, "why": "burnt"}).json()
    assert "waits again" in gone["said"]
    assert shop.cell("south", "claim", {"request": "r2"})["part"]["job"] == "lens"
    words = shop.ask("bob", "GET", "parts").json()["words"]
    assert [(one["who"], one["what"]) for one in words if one["why"] == "burnt"] == [
        ("ada", "cell is gone"),
        ("ada", "gone"),
    ]


def test_a_cell_that_has_a_token_and_never_connected_is_listed(shop: Asked, tmp_path: Path, polishd: Polishd) -> None:
    """Its link may have been forgotten, and it waits for parts in vain."""
    shop.cell("north", "report", REPORT)
    north, south = shop.ask("bob", "GET", "status").json()["cells"]
    assert (north["cell"], north["state"], north["away"]) == ("north", "idle", False)
    assert south == {"cell": "south", "heard_s": None, "away": True, "claims": 0, "passes": 0}
    said = polishd("shop", "status", tmp_path / "shop.toml")
    assert (said.code, "never: does polishd shop connect" in said.out) == (0, True), said.out


def test_a_token_is_for_its_own_side_alone(shop: Asked) -> None:
    for path in SERVED:
        for who in ("", "wrong", "ada"):
            assert shop.ask(who, "POST", f"cell/{path}", {}).status_code == 401, (who, path)
    for path in ("status", "parts", "history", "lessons"):
        assert shop.ask("bob", "GET", path).status_code == 200
        assert shop.ask("north", "GET", path).status_code == 401
    for path in ("add", "release", "remove"):
        assert shop.ask("bob", "POST", path, {}).status_code == 403
        assert shop.ask("north", "POST", path, {}).status_code == 401


def test_a_large_report_is_read_with_a_token_alone(shop: Asked) -> None:
    """A cell with a refused token learns of it, however much it sends."""
    large = json.dumps({**REPORT, "now": {"reason": "x" * 300_000}}).encode()
    assert shop.ask("north", "POST", "cell/report", large).status_code == 200
    assert shop.ask("wrong", "POST", "cell/report", large).status_code == 401


def test_guessing_tokens_locks_the_address_out(shop: Asked) -> None:
    for _ in range(WRONG + 1):
        assert shop.ask("wrong", "POST", "cell/claim", {}).status_code == 401
    assert shop.ask("north", "POST", "cell/claim", {"request": "r1"}).status_code == 200
    for k in range(BUDGET):
        shop.tokens["guess"] = f"guess{k}"
        assert shop.ask("guess", "POST", "cell/claim", {}).status_code == 401
    assert shop.ask("south", "POST", "cell/claim", {"request": "r2"}).status_code == 401
    assert shop.ask("north", "POST", "cell/claim", {"request": "r3"}).status_code == 200


@pytest.mark.parametrize(
    "said",
    [
        b"",
        b"{",
        b"[]",
        b'{"journal": "J"}',
        b"\xff",
        json.dumps({**REPORT, "more": 1}).encode(),
        json.dumps({**REPORT, "claims": [1]}).encode(),
        json.dumps({**REPORT, "claims": {"r": {}}}).encode(),
        json.dumps({**REPORT, "events": [[1]]}).encode(),
        json.dumps({**REPORT, "first": "x"}).encode(),
        json.dumps({**REPORT, "jobs": [[1 << 70, "a", "P", 5.0, None, None, None]]}).encode(),
        json.dumps({**REPORT, "jobs": [[1, None, "P", 5.0, None, None, None]]}).encode(),
    ],
)
def test_a_torn_report_is_refused_and_nothing_of_it_is_taken(shop: Asked, said: bytes) -> None:
    assert shop.ask("north", "POST", "cell/report", said).status_code in {400, 502}
    assert shop.cell("north", "report", REPORT)["upto"] == 1


def test_a_foreign_page_and_another_hosts_name_are_refused(shop: Asked) -> None:
    assert shop.ask("ada", "POST", "remove", {"job": "x"}, origin="http://evil.example").status_code == 403
    assert shop.ask("bob", "GET", "parts", host="evil.example").status_code == 421


@pytest.mark.parametrize(
    "said",
    [
        {},
        {"content": JOB},
        {"content": JOB, "files": {"lens.rnc": "no base 64"}},
        {"content": JOB, "files": {"../lens.rnc": ""}},
        {"content": JOB, "files": {"lens.rnc": "", "more.rnc": ""}},
        {"content": "[job]", "files": {}},
        {"content": JOB + "[robot]\n", "files": {"lens.rnc": ""}},
        {"content": JOB, "files": [1]},
    ],
)
def test_what_is_no_job_is_not_added(shop: Asked, said: dict[str, Any]) -> None:
    assert shop.ask("ada", "POST", "add", said).status_code == 400
    assert shop.ask("bob", "GET", "parts").json()["parts"] == []


def test_beyond_this_computer_only_with_tls_and_tokens(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="needs TLS"):
        write_shop(tmp_path, 'address = "192.0.2.1"\n')
    shop = write_shop(tmp_path, 'address = "192.0.2.1"\ncert = "c.pem"\nkey = "k.pem"\n')
    with pytest.raises(ConfigError, match="there is no token"):
        serve(shop)


def test_no_token_is_in_the_shops_folder(shop: Asked, tmp_path: Path) -> None:
    shop.cell("north", "report", REPORT)
    content = b"".join(path.read_bytes() for path in (tmp_path / "state").iterdir())
    assert not any(token.encode() in content for token in shop.tokens.values() if token)
