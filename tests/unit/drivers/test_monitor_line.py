"""Monitor: its lines against the document's vectors, and against nonsense."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import ProtocolError
from polishd.drivers import monitor_line as monitor_codec
from polishd.drivers.transport import lines
from tests.vectors import vectors

MONITOR = {name: line.encode() for name, line in vectors("monitor").items()}


def body(line: bytes) -> str:
    """Return the body of an answer."""
    found = lines.decode(line)
    assert found is not None
    return found[1]


@pytest.mark.parametrize(
    ("line", "number", "request_body"),
    [(MONITOR["list_request"], 7, "LS?,0"), (MONITOR["value_request"], 9, "V?,slurry_flow")],
)
def test_requests_are_those_of_the_document(line: bytes, number: int, request_body: str) -> None:
    assert lines.encode(number, request_body) == line + b"\r\n"


@pytest.mark.parametrize(("name", "value"), [("number", 1.25), ("unknown", None)])
def test_values_are_read_as_the_document_says(name: str, value: float | None) -> None:
    assert monitor_codec.parse_value("slurry_flow", body(MONITOR[name])) == value


def test_states_and_names_are_read_as_the_document_says() -> None:
    assert monitor_codec.parse_value("guard_closed", body(MONITOR["state"])) is True
    assert monitor_codec.parse_value("guard_closed", "V,guard_closed,OFF") is False
    assert monitor_codec.listed(0, body(MONITOR["list"])) == "slurry_flow"
    assert monitor_codec.listed(7, body(MONITOR["list_end"])) == ""


@pytest.mark.parametrize("answer", ["V,other,1.0", "V,flow,", "V,flow,nan", "V,flow,1e3", "V,flow,on", "V,flow", "OK"])
def test_what_is_no_value_is_a_protocol_error(answer: str) -> None:
    with pytest.raises(ProtocolError, match=r"no answer to V\?,flow"):
        monitor_codec.parse_value("flow", answer)


@pytest.mark.parametrize("answer", ["LS,1,flow", "LS,0,", "LS,0,a b", "LS,0flow", "LS", "LS,0,-x"])
def test_what_is_no_name_is_a_protocol_error(answer: str) -> None:
    with pytest.raises(ProtocolError, match=r"no answer to LS\?,0"):
        monitor_codec.listed(0, answer)


@given(st.text(max_size=30))
def test_nonsense_is_a_protocol_error_or_a_value(text: str) -> None:
    try:
        monitor_codec.parse_value("flow", text)
    except ProtocolError:
        return
    assert text[:2] == "V,"
