"""Members of a port come from its Protocol; each device is checked for them before anything is opened."""

from __future__ import annotations

import functools
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import pytest

from polishd.config.cell import PORTS as MARKS
from polishd.daemon.cell.device_polling import members, missing_members
from polishd.model.devices import ForceSample
from tests.fakes.devices import FakeActuator, FakeCell

PORTS = {name: mark.protocol for name, mark in MARKS.items()}
MEMBERS = [(section, name) for section, port in PORTS.items() for name in members(port)]


def test_members_are_the_ports_and_those_of_every_device() -> None:
    asked = members(PORTS["actuator"])
    assert {"open", "close", "identify", "status", "make_safe", "set_force", "samples", "retract"} <= set(asked)
    assert isinstance(members(PORTS["robot"])["buffer_s"], property)


@pytest.mark.parametrize("section", PORTS)
def test_the_fakes_have_all_that_their_ports_ask(section: Any) -> None:
    assert missing_members(getattr(FakeCell(), section), PORTS[section]) == []


@pytest.mark.one_of_each
@pytest.mark.parametrize(("section", "name"), MEMBERS)
def test_whatever_is_missing_is_named(section: Any, name: str) -> None:
    fake = getattr(FakeCell(), section)

    class Without:
        """The fake, but for one member."""

        def __getattr__(self, asked: str) -> Any:
            if asked == name:
                raise AttributeError(asked)
            return getattr(fake, asked)

    assert missing_members(Without(), PORTS[section]) == [f"it has no {name!r}"]


class Wrong(FakeActuator):
    """Everything is there, and not one thing as the port asks."""

    identify = "Acme"

    def set_force(self, force_n: float) -> None:  # type: ignore[override]
        """A def."""

    async def samples(self) -> list[ForceSample]:  # type: ignore[override]
        """Gives them all at once."""
        return []

    async def retract(self, slowly: bool) -> None:  # type: ignore[override]
        """Asks for more."""

    @property
    def make_safe(self) -> Any:  # type: ignore[override]
        """No method: it must not be asked of a device that is not open."""
        raise AssertionError("asked")


def test_what_is_there_in_another_shape_is_named() -> None:
    fake = FakeCell()
    said = missing_members(Wrong(fake.events, fake.clock), PORTS["actuator"])
    assert sorted(said) == [
        "its 'identify' is not a method but str",
        "its 'make_safe' is not a method but property",
        "its 'retract' cannot be called as retract(): missing a required argument: 'slowly'",
        "its 'samples' is not an async generator: write async def with yield",
        "its 'set_force' is not a coroutine: write async def",
    ]
    assert fake.events == [], "nothing was called"


def test_a_method_for_a_property_is_named() -> None:
    fake = FakeCell().robot
    fake.__class__ = type("Robot", (type(fake),), {"buffer_s": lambda self: 1.0})
    assert missing_members(fake, PORTS["robot"]) == ["its 'buffer_s' is a method; the port requires a property"]


def test_names_of_arguments_are_part_of_the_port() -> None:
    class Other(FakeActuator):
        async def set_force(self, newton: float) -> None:  # type: ignore[override]
            """Named otherwise."""

    fake = FakeCell()
    (said,) = missing_members(Other(fake.events, fake.clock), PORTS["actuator"])
    assert said.startswith("its 'set_force' cannot be called as set_force(force_n=...): ")


def test_other_ways_to_keep_a_port_are_let_pass() -> None:
    def logged(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def call(*words: Any, **named: Any) -> Any:
            return function(*words, **named)

        return call

    class Other(FakeActuator):
        @logged
        async def retract(self) -> None:
            """Behind a decorator."""

        def samples(self) -> AsyncIterator[ForceSample]:
            return super().samples()

        async def set_force(self, force_n: float, ramp_s: float = 1.0) -> None:
            """More than the port asks."""

    fake = FakeCell()
    assert missing_members(Other(fake.events, fake.clock), PORTS["actuator"]) == []

    class Listed(FakeActuator):
        def samples(self) -> Iterator[ForceSample]:  # type: ignore[override]
            yield from ()

    assert missing_members(Listed(fake.events, fake.clock), PORTS["actuator"]) == [
        "its 'samples' is not an async generator: write async def with yield"
    ]
