"""What a driver sends is found in its recording: in order, but for what repeats, and whatever number it bears."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from polishd.api import LineReader, LinkError, Tcp, open_stream
from polishd.drivers.transport.lines import encode
from polishd.model.errors import ConfigError
from polishd.testing.replay import ReplayScript, exchanges, replayed
from polishd.util.wire_recording import Way, WireMessage, header_line, passed_line
from tests.time_limits import SOON_S

CliResult = list[tuple[Way, bytes]]


def passed(said: CliResult, why: str = "the connection is closed") -> list[tuple[int, WireMessage]]:
    return [
        (at + 2, WireMessage(at * 0.1, "tool", "tcp://h:1", way, data, None, why if way == "end" else ""))
        for at, (way, data) in enumerate(said)
    ]


def script(*said: tuple[Way, bytes]) -> ReplayScript:
    return ReplayScript("case, tool", exchanges(passed(list(said))))


def answer(of: ReplayScript, asked: bytes) -> bytes:
    exchange = of.asked(asked)
    return of.dialect.answer(b"".join(data for _, data in exchange.came), exchange.out, asked)


POLLED: CliResult = [
    ("open", b""),
    ("out", b"?\n"),
    ("in", b"up\n"),
    ("out", b"?\n"),
    ("in", b"up\n"),
    ("out", b"F5\n"),
    ("in", b"ok\n"),
    ("out", b"?\n"),
    ("in", b"contact\n"),
    ("end", b""),
]


@pytest.mark.parametrize("polls", [0, 1, 2, 7])
def test_polls_come_as_often_as_they_like(polls: int) -> None:
    said = script(*POLLED)
    assert [answer(said, b"?\n") for _ in range(min(polls, 2))] == [b"up\n"] * min(polls, 2)
    assert answer(said, b"F5\n") == b"ok\n"
    assert {answer(said, b"?\n") for _ in range(3)} == {b"contact\n"}


def test_an_order_is_not_passed_over() -> None:
    said = script(
        ("out", b"F5\n"), ("in", b"ok\n"), ("out", b"U\n"), ("in", b"ok\n"), ("out", b"I\n"), ("in", b"Acme\n")
    )
    answer(said, b"F5\n")
    with pytest.raises(AssertionError, match=r"^case, tool: the driver sent 'I\\n'; .* has 'U\\n' \(line 4\)$"):
        said.asked(b"I\n")
    said.asked(b"U\n")
    said.asked(b"I\n")
    with pytest.raises(AssertionError, match=r"the driver sent 'X\\n'; the recording ends here$"):
        said.asked(b"X\n")


def test_a_modbus_transaction_has_the_number_of_its_request() -> None:
    ask, reply = bytes.fromhex("0007 0000 0006 01 03 0000 0001"), bytes.fromhex("0007 0000 0005 01 03 02 1234")
    said = script(("out", ask), ("in", reply))
    assert answer(said, b"\x00\x63" + ask[2:]) == b"\x00\x63" + reply[2:]
    assert said.dialect.cut(ask + ask[:5]) == len(ask)
    assert said.dialect.cut(ask[:7]) is None


def test_a_numbered_line_has_the_number_of_its_request() -> None:
    said = script(("out", encode(3, "ID?")), ("in", encode(2, "LATE") + encode(3, "ID,a")))
    assert answer(said, encode(9, "ID?")) == encode(2, "LATE") + encode(9, "ID,a")


def written(folder: Path, said: list[tuple[int, WireMessage]]) -> Path:
    path = folder / "case.jsonl"
    path.write_bytes(header_line("0", "cell", "", {}) + b"".join(passed_line(one, 0.0) for _, one in said))
    return path


@pytest.mark.parametrize("paced", [False, True])
async def test_a_link_that_was_lost_is_lost_again(tmp_path: Path, *, paced: bool) -> None:
    said: CliResult = [("open", b""), ("in", b"hello\n"), ("out", b"?\n"), ("in", b"u"), ("in", b"p\n"), ("end", b"")]
    path = written(tmp_path, passed(said, "the peer closed the connection"))
    async with replayed(path, "tool", paced=paced) as link:
        host, port = link.endpoint.removeprefix("tcp://").split(":")
        stream = await open_stream(Tcp(host, int(port)), SOON_S)
        assert await stream.read(6, SOON_S) == b"hello\n"
        await stream.write(b"?\n")
        lines = LineReader(stream, 64)
        assert await lines.next(SOON_S) == b"up"
        with pytest.raises(LinkError, match="the peer closed the connection"):
            await stream.read(64, SOON_S)
        await stream.close()


async def test_one_of_several_links_is_named(tmp_path: Path) -> None:
    rows = passed([("open", b"")])
    path = written(tmp_path, rows)
    other = json.loads(passed_line(rows[0][1], 0.0)) | {"link": "tcp://h:2"}
    with path.open("a") as file:
        file.write(json.dumps(other) + "\n")
    with pytest.raises(ConfigError, match=r"tool has the links tcp://h:1, tcp://h:2"):
        async with replayed(path, "tool"):
            pass
    async with replayed(path, "tool", link="tcp://h:2") as link:
        assert link.endpoint.startswith("tcp://127.0.0.1:")
