"""``polishd notify``, and what is wrong with a ``[notify.NAME]``: file, line and key are named, without the secret."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.assembly import build_notifiers
from polishd.daemon.notifications.sender import outbox_path
from polishd.plugin_loader import load_cell
from tests.fakes.receivers import web_server
from tests.unit.cli_result import Polishd

DOCS = Path(__file__).resolve().parents[3] / "docs" / "how-to" / "notifications.md"
SECRET = "hunter2-and-more"
LOAD = '"plan_checks"'
PAGER = """
from pydantic import BaseModel

class Options(BaseModel):
    number: str = "1"

{body}

@hookimpl
def polishd_notifiers():
    return [NotifierType("pager", Options, build)]
"""


@pytest.fixture
def cell(tmp_path: Path, example: str) -> Callable[..., Path]:
    """``cell(text, plugins=(...))``: the shipped example with these sections."""

    def write(text: str, plugins: tuple[str, ...] = ("notifications",)) -> Path:
        (tmp_path / "secret").write_text(SECRET)
        (tmp_path / "secret").chmod(0o600)
        path = tmp_path / "cell.toml"
        load = ", ".join([LOAD, *(f'"{name}"' for name in plugins)])
        path.write_text(example.replace(LOAD, load) + text)
        return path

    return write


def test_each_notifier_says_how_its_test_went(cell: Any, polishd: Polishd, tmp_path: Path) -> None:
    with web_server() as hook, web_server(status=403, answer=f"not with {SECRET}") as closed:
        hooks = {"hook": hook.url, "closed": closed.url}
        lines = [
            f'[notify.{name}]\ntype = "webhook"\nurl = "{url}"\ntoken = "file:secret"' for name, url in hooks.items()
        ]
        path = cell("\n".join(lines))
        shown = polishd("notify", path, "--json")
        for_people = polishd("notify", path)
    found = {one["notifier"]: one for one in json.loads(shown.out)["notifiers"]}
    assert (shown.code, for_people.code) == (5, 5)
    assert found["hook"] == {"notifier": "hook", "type": "webhook", "severity": "warning", "error": "", "waiting": 0}
    assert "answered 403" in found["closed"]["error"]
    assert hook.wait()["event"] == "test"
    assert SECRET not in shown.out + shown.err + for_people.out + for_people.err
    assert not outbox_path(tmp_path / "state", "hook").exists(), "it is no daemon's affair"


def test_all_well_is_0_and_what_a_daemon_left_is_counted(cell: Any, polishd: Polishd, tmp_path: Path) -> None:
    path = cell('[notify.siren]\ntype = "command"\nargv = ["sh", "-c", "cat > sent"]\n')
    assert polishd("notify", path).code == 0
    left = json.loads((tmp_path / "sent").read_text())
    left = {key: value for key, value in left.items() if key not in {"title", "text"}}
    kept = outbox_path(tmp_path / "state", "siren")
    kept.parent.mkdir(parents=True)
    kept.write_text(json.dumps({"waiting": [left], "told": {}}))
    shown = polishd("notify", path, "--json")
    assert (shown.code, json.loads(shown.out)["notifiers"][0]["waiting"]) == (0, 1)
    assert json.loads(kept.read_text())["waiting"] == [left], "it is the daemon's to send"


def test_the_example_of_the_docs_is_one(cell: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (text,) = re.findall(r"^```toml\n(.*?)^```", DOCS.read_text(), re.DOTALL | re.MULTILINE)
    path = cell(text)
    monkeypatch.setenv("NTFY_TOKEN", SECRET)
    for name, content in {"mail.password": SECRET, "chat.url": "https://chat.example.org/T0", "siren.py": ""}.items():
        (tmp_path / name).write_text(content)
        (tmp_path / name).chmod(0o700)
    found = build_notifiers(*load_cell(path))
    assert [(one.name, one.least) for one in found] == [
        ("mail", "warning"), ("chat", "info"), ("phone", "alarm"), ("siren", "alarm")
    ]  # fmt: skip


OWN = ("notifications",)
MAIL = '[notify.mail]\ntype = "email"\nhost = "here"\nsender = "a@b.c"\nto = ["a@b.c"]\n'


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("text", "plugins", "says"),
    [
        ("", OWN, "notify: there is no notifier"),
        (MAIL, (), "notify.mail.type: unknown type 'email'. The loaded plugins have: none; plugins.load must name its"),
        ("[notify.mail]\n", OWN, "notify.mail.type: is missing; add it: type = ..."),
        (MAIL + 'severity = "loud"\n', OWN, "notify.mail.severity: 'loud' is not allowed; must be 'info'"),
        (MAIL + "remind_after_s = -1.0\n", OWN, "notify.mail.remind_after_s: -1.0 is out of range; must be at least 0"),
        (MAIL + "prot = 25\n", OWN, "notify.mail.prot: unknown key; did you mean 'port'? Known here:"),
        (MAIL + f'user = "u"\npassword = "{SECRET}"\n', OWN, "password: a secret does not stand in a config"),
        (MAIL + 'user = "u"\npassword = "file:none"\n', OWN, "notify.mail.password: 'file:none': cannot be"),
        ('[notify."a b"]\ntype = "email"\n', OWN, "'a b' is not allowed; use letters, digits,"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_reported_by_its_key(
    cell: Any, polishd: Polishd, text: str, plugins: tuple[str, ...], says: str
) -> None:
    shown = polishd("notify", cell(text, plugins))
    assert shown.code == 3
    assert says in shown.err
    assert SECRET not in shown.out + shown.err


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("def build(options, base_dir): raise ValueError('no line')", "cannot be built: ValueError: no line"),
        ("def build(options, base_dir): return 3", "cannot be built: TypeError: int cannot be called"),
    ],
)
def test_a_broken_plugin_is_refused_by_name(cell: Any, polishd: Polishd, install: Any, body: str, says: str) -> None:
    install("acme", PAGER.format(body=body))
    done = polishd("notify", cell('[notify.me]\ntype = "pager"\n', ("acme",)))
    assert done.code == 3
    assert f"notify.me.type: plugin 'acme', notifier type 'pager': {says}. Correct the plugin" in done.err


def test_a_notifier_of_a_plugin(cell: Any, polishd: Polishd, install: Any, tmp_path: Path) -> None:
    body = "def build(options, base_dir): return lambda it: (base_dir / 'sent').write_text(options.number + it.text)"
    install("acme", PAGER.format(body=body))
    path = cell('[notify.me]\ntype = "pager"\nnumber = "4711"\n', ("acme",))
    assert polishd("notify", path).code == 0
    assert (tmp_path / "sent").read_text().startswith("4711what happened: this is a test")
