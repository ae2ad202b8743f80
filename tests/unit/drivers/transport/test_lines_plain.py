"""Lines without numbers: an answer is never taken for another's, and silence ends the link."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass, field

import pytest

from polishd.api import DeviceRefused, LinkError, PlainLines, ProtocolError, Tcp
from tests.fakes.wires import Peer, TcpWire, dribbled
from tests.time_limits import SOON_S


class Echo(Peer):
    """Answers a line once it is allowed to."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[str] = []
        self.held: list[bytes] | None = None

    def on_bytes(self, data: bytes) -> None:
        for line in data.splitlines(keepends=True):
            self.asked.append(line.decode().strip())
            if self.held is None:
                self.send(line)
            else:
                self.held.append(line)

    def let(self) -> None:
        """Send what was held back."""
        held, self.held = self.held or [], None
        self.send(b"".join(held))


@dataclass
class Link:
    """A client and its peer."""

    echo: Echo
    wire: TcpWire
    lines: PlainLines = field(init=False)

    def __post_init__(self) -> None:
        self.lines = PlainLines(Tcp("127.0.0.1", self.wire.port), 2.0, hello="?", refusal="NO")


@pytest.fixture
async def link() -> AsyncIterator[Link]:
    echo = Echo()
    wire = await TcpWire(echo).start()
    found = Link(echo, wire)
    yield found
    await found.lines.close()
    await wire.close()


async def until_asked(echo: Echo, line: str) -> None:
    async with asyncio.timeout(SOON_S):
        while line not in echo.asked:  # noqa: ASYNC110 -- the fake sends no event
            await asyncio.sleep(0)


async def test_it_says_hello_and_asks(link: Link) -> None:
    link.echo.filter = dribbled
    await link.lines.open()
    assert await link.lines.ask("a b") == "a b"
    assert await link.lines.read("12.5", float) == 12.5
    assert link.echo.asked == ["?", "a b", "12.5"]


async def test_refused_and_unknown_requests_are_distinguished(link: Link) -> None:
    await link.lines.open()
    with pytest.raises(DeviceRefused, match="NO way was refused"):
        await link.lines.ask("NO way")
    with pytest.raises(ProtocolError, match="who was answered by 'who'"):
        await link.lines.read("who", float)
    assert link.lines.is_open


async def test_the_answer_to_a_cancelled_caller_is_not_the_next_ones(link: Link) -> None:
    await link.lines.open()
    link.echo.held = []
    first = asyncio.create_task(link.lines.ask("first"))
    await until_asked(link.echo, "first")
    first.cancel()
    second = asyncio.create_task(link.lines.ask("second"))
    await asyncio.sleep(0)
    link.echo.let()
    assert await second == "second"


async def test_urgent_lines_overtake(link: Link) -> None:
    await link.lines.open()
    link.echo.held = []
    waiting = [asyncio.create_task(link.lines.ask(line)) for line in ("a", "b", "c")]
    await until_asked(link.echo, "a")
    urgent = asyncio.create_task(link.lines.ask("stop", urgent=True))
    await asyncio.sleep(0)
    link.echo.let()
    await asyncio.gather(urgent, *waiting)
    assert link.echo.asked[1:] == ["a", "stop", "b", "c"]


async def test_silence_ends_the_link_until_it_is_opened(link: Link) -> None:
    link.lines = PlainLines(Tcp("127.0.0.1", link.wire.port), 0.05, hello="?")
    await link.lines.open()
    link.echo.silent = True
    with pytest.raises(LinkError, match="no answer to a"):
        await link.lines.ask("a")
    assert not link.lines.is_open
    link.echo.silent = False
    with pytest.raises(LinkError, match="lost"):
        await link.lines.ask("b")
    assert "b" not in link.echo.asked
    await link.lines.open()
    assert await link.lines.ask("c") == "c"


async def test_a_silent_device_is_not_opened(link: Link) -> None:
    link.lines = PlainLines(Tcp("127.0.0.1", link.wire.port), 0.05, hello="?")
    link.echo.silent = True
    with pytest.raises(LinkError, match=r"no answer to \?"):
        await link.lines.open()
    assert not link.lines.is_open


async def test_a_block_leaves_it_as_it_was(link: Link) -> None:
    async with link.lines.opened():
        assert await link.lines.ask("a") == "a"
    assert not link.lines.is_open
    await link.lines.open()
    async with link.lines.opened():
        assert link.lines.is_open
    assert await link.lines.ask("b") == "b"
