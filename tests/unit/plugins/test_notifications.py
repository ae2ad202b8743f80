"""E-mail, webhook and command with real servers and processes: arrivals, refusals, and secrets that stay secret."""

from __future__ import annotations

import json
import os
import shutil
import ssl
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from polishd.model.errors import ConfigError, LinkError
from polishd.model.notification import Notification
from polishd.model.states import Severity
from polishd.plugins import notifications
from polishd.plugins.notifications import REPLY_BYTES, polishd_notifiers
from tests.fakes.receivers import mail_server, web_server
from tests.system.sim_rig import alive, wait_for
from tests.time_limits import within

SECRET = "hunter2-and-more"
KINDS = {kind.name: kind for kind in polishd_notifiers()}
ALARM = Notification(
    id="abc",
    event="failed",
    severity=Severity.ALARM,
    what="failed: SafetyStop: force 7.20 N is outside 12 N ± 25%\nBcc: eve@example.org",
    now="the daemon has ended; tool off the part: yes",
    todo="look at the cell, then: polishd run cell.toml",
    cell="bench",
    job="demo",
    part="P-1",
    cycle=2,
    run_dir="runs/demo",
    at="2026-11-22T02:14:09+00:00",
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Create the folder of the cell file with a secret that only its owner can read."""
    (tmp_path / "secret").write_text(f"{SECRET}\n")
    (tmp_path / "secret").chmod(0o600)
    return tmp_path


def notifier(kind: str, folder: Path, **keys: Any) -> Any:
    return KINDS[kind].build(KINDS[kind].options(**keys), folder)


def mail_to(folder: Path, port: int, **keys: Any) -> Any:
    given = {"host": "127.0.0.1", "port": port, "sender": "cell@example.org", "to": ["ada@example.org"]}
    return notifier("email", folder, **(given | {"security": "none"} | keys))


# e-mail


def test_a_mail_shows_control_characters_and_obeys_none(folder: Path) -> None:
    evil = "robot: \x1b]0;owned\x07 \x9b2J"
    with mail_server() as server:
        mail_to(folder, server.port)(replace(ALARM, what=evil, part=evil, now=evil))
        ((_, mail),) = server.taken
    shown = r"robot: \u001b]0;owned\u0007 \u009b2J"
    assert shown in " ".join(mail["Subject"].split())
    assert mail.get_content().count(shown) == 3


def test_a_mail_says_all_and_its_header_nothing_else(folder: Path) -> None:
    with mail_server() as server:
        mail_to(folder, server.port, to=["ada@example.org", "bob@example.org"])(ALARM)
        (to, mail) = server.taken[0]
    assert to == ["ada@example.org", "bob@example.org"]
    assert (mail["To"], mail["From"]) == ("ada@example.org, bob@example.org", "cell@example.org")
    assert " ".join(mail["Subject"].split()) == ALARM.title
    assert mail["Bcc"] is None
    assert (mail["Message-ID"], mail["Auto-Submitted"], mail["X-Priority"]) == ("<abc@polishd>", "auto-generated", "1")
    assert mail["Date"] == "Sun, 22 Nov 2026 02:14:09 +0000"
    assert mail.get_content().splitlines() == ALARM.text.splitlines()


def test_a_mail_is_sent_again_to_those_alone_whom_it_did_not_reach(folder: Path) -> None:
    with mail_server(refuses={"bob@example.org": "450 later"}) as server:
        send = mail_to(folder, server.port, to=["ada@example.org", "bob@example.org"])
        with pytest.raises(LinkError, match=r"127\.0\.0\.1:\d+: refused bob@example.org: 450 later"):
            send(ALARM)
        server.refuses.clear()
        send(ALARM)
    assert [to for to, _ in server.taken] == [["ada@example.org"], ["bob@example.org"]]


@pytest.mark.parametrize(
    ("refuses", "says"),
    [
        ({"ada@example.org": "550 who"}, "refused ada@example.org: 550 who"),
        ({"MAIL": "451 greylisted"}, "answered 451 greylisted"),
    ],
)
def test_a_server_that_refuses_is_reported(folder: Path, refuses: dict[str, str], says: str) -> None:
    with mail_server(refuses=refuses) as server, pytest.raises(LinkError, match=says):
        mail_to(folder, server.port)(ALARM)


def test_a_server_that_hangs_is_given_up_in_time(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("polishd.plugins.notifications.STEP_S", 0.2)
    with mail_server() as server:
        server.silent.set()
        with within(10.0), pytest.raises(LinkError, match="timed out"):
            mail_to(folder, server.port)(ALARM)


def test_a_server_that_is_not_there_is_reported(folder: Path) -> None:
    with mail_server() as server:
        port = server.port
    with pytest.raises(LinkError, match=rf"127\.0\.0\.1:{port}: .*refused"):
        mail_to(folder, port)(ALARM)


def test_a_login_that_is_refused_does_not_tell_the_password(folder: Path) -> None:
    with mail_server(refuses={"AUTH": f"535 wrong: {SECRET}"}) as server:
        send = mail_to(folder, server.port, user="cell", password="file:secret")
        with pytest.raises(LinkError) as refused:
            send(ALARM)
    assert server.logins[0] == f"\0cell\0{SECRET}"
    assert "login as 'cell' refused: 535 wrong: ***" in str(refused.value)
    assert SECRET not in repr(refused.value)
    assert refused.value.__suppress_context__


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ssl.SSLContext]:
    """Return the certificate file of a private authority and the context of a server."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl makes the certificate, and is not installed")
    folder = tmp_path_factory.mktemp("tls")
    key, found = folder / "key.pem", folder / "ca.pem"
    names = ["-subj", "/CN=here", "-addext", "subjectAltName=IP:127.0.0.1"]
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    subprocess.run([*command, *names, "-keyout", key, "-out", found, "-days", "2"], check=True, capture_output=True)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(found, key)
    return found, context


def test_starttls_with_a_server_of_the_house(folder: Path, certificate: tuple[Path, ssl.SSLContext]) -> None:
    trusted, context = certificate
    with mail_server(context=context) as server:
        keys = {"security": "starttls", "user": "cell", "password": "file:secret"}
        mail_to(folder, server.port, ca_file=str(trusted), **keys)(ALARM)
        assert (len(server.taken), server.logins) == (1, [f"\0cell\0{SECRET}"])
        with pytest.raises(LinkError, match="certificate verify failed"):
            mail_to(folder, server.port, **keys)(ALARM)
        assert len(server.logins) == 1, "no login to an unknown server"


def test_a_server_without_starttls_does_not_get_the_password(folder: Path) -> None:
    with mail_server() as server:
        with pytest.raises(LinkError, match="STARTTLS extension not supported"):
            mail_to(folder, server.port, security="starttls", user="cell", password="file:secret")(ALARM)
        assert server.logins == []


# webhook


def test_a_webhook_has_all_fields(folder: Path) -> None:
    with web_server() as hook:
        notifier("webhook", folder, url=f"{hook.url}/cells?of=bench", token="file:secret")(ALARM)
        assert hook.wait() == json.loads(json.dumps(ALARM.facts()))
    path, headers, _ = hook.posted[0]
    assert (path, headers["content-type"]) == ("/cells?of=bench", "application/json")
    assert headers["authorization"] == f"Bearer {SECRET}"


def test_slack_and_ntfy_get_what_they_take(folder: Path) -> None:
    with web_server() as hook:
        notifier("webhook", folder, url=hook.url, format="slack")(ALARM)
        assert hook.wait() == {"text": f"*{ALARM.title}*\n{ALARM.text}"}
        notifier("webhook", folder, url=f"{hook.url}/cell", format="ntfy")(ALARM)
    path, headers, body = hook.posted[1]
    assert (path, headers["priority"], body.decode()) == ("/cell", "5", ALARM.text)
    assert headers["title"].startswith("bench: alarm: failed: SafetyStop: force 7.20 N is outside 12 N ? 25%")


@pytest.mark.parametrize("status", [301, 403, 500])
def test_a_webhook_that_is_not_accepted_tells_the_host_and_no_secret(folder: Path, status: int) -> None:
    (folder / "url").touch(0o600)
    with web_server(status=status, answer=f"/hook/T0/{SECRET} and {SECRET} " + "x" * 1000) as hook:
        (folder / "url").write_text(f"{hook.url}/hook/T0")
        send = notifier("webhook", folder, url="file:url", token="file:secret")
        with pytest.raises(LinkError) as refused:
            send(ALARM)
    said = str(refused.value)
    assert said.startswith(f"{hook.url}: answered {status} ")
    assert SECRET not in said
    assert "/hook/T0" not in said
    assert len(said) < REPLY_BYTES + 100


def test_a_webhook_over_tls(folder: Path, certificate: tuple[Path, ssl.SSLContext]) -> None:
    trusted, context = certificate
    with web_server(context) as hook:
        notifier("webhook", folder, url=hook.url, ca_file=str(trusted))(ALARM)
        with pytest.raises(LinkError, match="certificate verify failed"):
            notifier("webhook", folder, url=hook.url)(ALARM)
    assert len(hook.posted) == 1


# command


def script(folder: Path, text: str) -> list[str]:
    (folder / "notify.py").write_text(text)
    return [sys.executable, str(folder / "notify.py")]


def test_a_command_reads_the_notification(folder: Path) -> None:
    argv = script(folder, "import sys; open(sys.argv[1], 'w').write(sys.stdin.read())")
    notifier("command", folder, argv=[*argv, "given.json"])(ALARM)
    assert json.loads((folder / "given.json").read_text()) == json.loads(json.dumps(ALARM.facts()))


def test_a_command_beside_the_cells_file(folder: Path) -> None:
    (folder / "notify").write_text("#!/bin/sh\ncat > given\n")
    (folder / "notify").chmod(0o700)
    notifier("command", folder, argv=["./notify"])(ALARM)
    assert (folder / "given").stat().st_size > 0


def test_a_command_that_fails_tells_its_last_words(folder: Path) -> None:
    argv = script(folder, "import sys; sys.exit('x' * 2000 + ' no modem')")
    with pytest.raises(LinkError, match=r"ended with 1: x+ no modem$") as failed:
        notifier("command", folder, argv=argv)(ALARM)
    assert len(str(failed.value)) < 700


def test_a_command_that_hangs_is_killed_with_what_it_started(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A child that holds its output open does not extend the wait. The time is over once the child exists."""
    wait = subprocess.Popen.wait

    def up(process: Any, timeout: float | None = None) -> int:
        if timeout is None:
            return int(wait(process))
        wait_for((folder / "child").exists, "the child")
        raise subprocess.TimeoutExpired("notify", timeout)

    monkeypatch.setattr(subprocess.Popen, "wait", up)
    argv = ["sh", "-c", "sleep 600 & echo $! > new; mv new child; wait"]
    with pytest.raises(LinkError, match=r"was killed after 30 s"):
        notifier("command", folder, argv=argv)(ALARM)
    pid = int((folder / "child").read_text())
    wait_for(lambda: not alive(pid), "its end")


def test_a_command_has_its_time_and_no_more(folder: Path) -> None:
    with within(30.0), pytest.raises(LinkError, match=r"was killed after 0.1 s"):
        notifier("command", folder, argv=["sleep", "600"], timeout_s=0.1)(ALARM)


# what is refused before anything is sent


@pytest.mark.parametrize(
    ("kind", "keys", "says"),
    [
        ("email", {"password": SECRET}, "a secret does not stand in a config"),
        ("email", {"password": 4711}, "a secret does not stand in a config"),
        ("email", {"password": "env:MAIL_PASSWORD", "user": None}, "goes with user"),
        ("email", {"security": "none", "host": "mail.example.org"}, "not sent in the clear"),
        ("email", {"to": []}, "at least 1 item"),
        ("email", {"to": ["ada@example.org\nBcc: eve@example.org"]}, "is no address"),
        ("webhook", {"url": "hooks.example.org"}, "is no URL"),
        ("webhook", {"url": f"https://cell:{SECRET}@hooks.example.org"}, "a config must not contain a password"),
        ("webhook", {"url": "https://hooks.example.org:port/"}, "is no URL"),
        ("webhook", {"url": "https://hooks.example.org/a b"}, "is no URL"),
        ("webhook", {"token": SECRET}, "a secret does not stand in a config"),
        ("command", {"argv": []}, "at least 1 item"),
    ],
)
def test_wrong_options(kind: str, keys: dict[str, Any], says: str) -> None:
    right = {
        "email": {
            "host": "here", "sender": "a@b.c", "to": ["a@b.c"], "user": "cell", "password": "file:secret"
        },
        "webhook": {"url": "https://hooks.example.org/T0"},
        "command": {"argv": ["cat"]},
    }  # fmt: skip
    with pytest.raises(ValidationError) as refused:
        KINDS[kind].options(**right[kind] | keys)
    (found,) = refused.value.errors()
    assert says in found["msg"]
    assert SECRET not in found["msg"]


@pytest.mark.parametrize(
    ("kind", "keys", "says"),
    [
        ("email", {"password": "file:none"}, "'file:none': cannot be read: .*No such file"),
        ("email", {"password": "file:open"}, "'file:open': mode 0644 of .* gives its secret to others.*: chmod 600 "),
        ("email", {"password": "file:empty"}, "'file:empty': holds no secret"),
        ("email", {"password": "file:binary"}, "'file:binary': .* is no UTF-8 text"),
        ("email", {"password": "env:NO_SUCH_VARIABLE"}, "'env:NO_SUCH_VARIABLE': holds no secret"),
        ("email", {"ca_file": "secret"}, "'secret': cannot be read"),
        ("webhook", {"url": "file:secret"}, "'file:secret': the value there is no URL"),
        (
            "webhook",
            {"url": "http://hooks.example.org", "token": "file:secret"},
            "'file:secret': a token needs encryption",
        ),
        ("command", {"argv": ["no-such-program"]}, "'no-such-program': no such executable program"),
        ("command", {"argv": ["./secret"]}, "'./secret': no such executable program"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_is_sent(
    folder: Path, kind: str, keys: dict[str, Any], says: str
) -> None:
    for name, content in {"open": b"x", "empty": b"\n", "binary": b"\xff\xfe"}.items():
        (folder / name).write_bytes(content)
        (folder / name).chmod(0o644 if name == "open" else 0o600)
    mail = {"host": "here", "sender": "a@b.c", "to": ["a@b.c"], "user": "cell", "password": "file:secret"}
    with pytest.raises(ConfigError, match=says) as refused:
        notifier(kind, folder, **(mail if kind == "email" else {}) | keys)
    assert SECRET not in str(refused.value)


def test_a_secret_of_the_environment(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CELL_PASSWORD", SECRET)
    with mail_server() as server:
        mail_to(folder, server.port, user="cell", password="env:CELL_PASSWORD")(ALARM)
        assert server.logins == [f"\0cell\0{SECRET}"]
        assert "CELL_PASSWORD" in os.environ


def test_this_computer_is_known_by_its_names() -> None:
    assert {"localhost", "127.0.0.1", "::1"} == notifications.LOOPBACK
