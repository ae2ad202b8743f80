"""No request of any client to any endpoint causes an internal error or an answer that is not JSON."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from polishd.web.http import server
from polishd.web.http.users import Role
from polishd.web.routes import ROUTES, ApiRoute
from tests.unit.web.page_server import Served, served

ANSWERS = {200, 202, 400, 401, 403, 404, 405, 409}
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)
PIECES = st.integers(0, 1 << 70).map(str) | st.sampled_from(["measured", "..", "%2e%2e", "%00", "-1", "1e9", "a" * 300])


@pytest.fixture(scope="module")
def web(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with pytest.MonkeyPatch.context() as patch, served(tmp_path_factory.mktemp("web")) as found:
        patch.setattr(server, "PER_S", 1e9)
        yield found


@st.composite
def asked(draw: st.DrawFn) -> tuple[ApiRoute, str, Role | None, dict[str, Any]]:
    route = draw(st.sampled_from([one for one in ROUTES if one.path != "/api/events"]))
    path = re.sub(r"{\w+(:number)?}", lambda _: draw(PIECES), route.path)
    if draw(st.booleans()):
        path += f"?{draw(st.sampled_from(['before', 'px', 'encoding', 'points']))}={draw(PIECES)}"
    body: dict[str, Any] = {}
    if route.method == "POST":
        known = {name.rstrip("?"): VALUES for name, _ in route.fields}
        body = draw(
            st.fixed_dictionaries({}, optional=known).map(lambda one: {"json": one})
            | VALUES.map(lambda one: {"json": one})
            | st.binary(max_size=200).map(lambda one: {"content": one})
        )
    return route, path, draw(st.sampled_from([None, *Role])), body


@pytest.mark.full
@given(question=asked())
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_question_is_a_fault(web: Served, question: tuple[ApiRoute, str, Role | None, dict[str, Any]]) -> None:
    route, path, role, body = question
    said = web.ask(route.method, path, role, **body)
    assert said.status_code in ANSWERS, (route.path, body, said.text)
    assert isinstance(said.json(), dict)
