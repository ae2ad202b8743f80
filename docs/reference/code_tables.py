"""Tables of the reference that come from the code: states, socket, keys of a job, ends of a job, events, HTTP API."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import get_type_hints

from polishd.daemon.job.resume_checks import RULES as JOB_RULES
from polishd.daemon.queue.queue import RULES as RESULT_RULES
from polishd.daemon.queue.queue import TORN, ResultRule
from polishd.daemon.socket.client import VERBS
from polishd.daemon.state_machine import DOES, ORDERS, TRANSITIONS
from polishd.model.events import EVENTS, Event
from polishd.model.states import DaemonState, Outcome
from polishd.web.http.users import Role
from polishd.web.routes import ROUTES, open_path

FOLDER = Path(__file__).parent
OPEN_ENDPOINTS = (
    ("POST", "/api/session", "sign in: a cookie for a token"),
    ("GET", "/api/openapi.json", "this API as an OpenAPI document"),
)
"""Endpoints without a user; `ROUTES` has the others."""
MARK = "<!-- Written by `make reference` from the code. -->"


def _table(*columns: str, rows: Sequence[Sequence[str]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"|{'|'.join(line)}|" if "---" in line else f"| {' | '.join(line)} |" for line in lines)


def states() -> str:
    """Return what the daemon does in each state."""
    return _table("state", "what happens in it", rows=[(f"`{state}`", DOES[state]) for state in DaemonState])


def transitions() -> str:
    """Return the transitions between states; commands look like commands."""
    rows = []
    for row in TRANSITIONS:
        trigger = f"`{row.trigger}`" if row.trigger in ORDERS else row.trigger.value
        unattended = f"`{row.unattended}`" if row.unattended else ""
        rows.append((f"`{row.source}`", trigger, f"`{row.target}`", unattended, row.note))
    return _table("in", "when", "next", "with `--no-hold`", "note", rows=rows)


def commands() -> str:
    """Return the commands of the socket with their arguments."""
    rows = [
        (
            f"`{verb.name}`",
            verb.what,
            verb.changes,
            "; ".join(f"`{one.name}` ({one.kind.__name__}): {one.what}" for one in verb.arguments),
        )
        for verb in VERBS.values()
    ]
    return _table("verb", "what", "changes anything", "arguments", rows=rows)


def job_keys() -> str:
    """Return which config keys may change within a job."""
    rows = [
        (", ".join(f"`{key}`" for key in rule.keys), "yes" if rule.may_change else "no", rule.why) for rule in JOB_RULES
    ]
    return _table("keys", "may change", "why", rows=rows)


def _result(rule: ResultRule, *, torn: bool = False) -> tuple[str, str, str, str]:
    ends = ", ".join(f"`{end.value if isinstance(end, Outcome) else end.__name__}`" for end in rule.ends)
    return f"{ends}{' that cut off a pass' if torn else ''}", rule.how or "its job is not over", rule.queue, rule.why


def job_results() -> str:
    """Return what each end of a job means for part and queue."""
    rows = [_result(TORN, torn=True), *map(_result, RESULT_RULES)]
    return _table("what ended it", "the part is", "the queue", "why", rows=rows)


def event_row(kind: type[Event]) -> tuple[str, str, str]:
    """Return names, description and fields of an event."""
    hints = get_type_hints(kind, include_extras=True)
    own = [f"`{item.name}`: {hints[item.name].__metadata__[0]}" for item in fields(kind) if item.name != "cycle"]
    return f"`{kind.__name__}`, `{kind.name}`", kind.__doc__ or "", "; ".join(own)


def all_events() -> str:
    """Return all events with their fields."""
    return _table("event", "when", "fields", rows=[event_row(kind) for kind in EVENTS])


def notifying_events() -> str:
    """Return the events that notify an operator, with the severity that their ``concern`` states."""
    kinds = [kind for kind in EVENTS if kind.concern is not Event.concern]
    rows = [(f"`{kind.__name__}`, `{kind.name}`", kind.concern.__doc__ or "") for kind in kinds]
    return _table("event", "severity", rows=rows)


def endpoints() -> str:
    """Return each endpoint of the HTTP API, without a user and with each role."""
    rows = [(f"`{method}`", f"`{path}`", "yes", *["yes"] * len(Role), what) for method, path, what in OPEN_ENDPOINTS]
    for route in ROUTES:
        may = ["yes" if role.may(route.role) else "403" for role in Role]
        rows.append((f"`{route.method}`", f"`{open_path(route.path)}`", "401", *may, route.what))
    return _table("method", "path", "no user", *Role, "what", rows=rows)


PAGES: Mapping[str, Sequence[Callable[[], str]]] = {
    "daemon.md": (states, transitions, commands, job_keys, job_results),
    "events.md": (all_events, notifying_events),
    "http-api.md": (endpoints,),
}


def laid_into(name: str, text: str) -> str:
    """Return the page with its tables as the code has them; each replaces the table with the same header."""
    for made in PAGES[name]:
        table = made()
        replacement = f"{MARK}\n\n{table}\n"
        header = re.escape(table.splitlines()[0])
        text, count = re.subn(
            rf"(?:{re.escape(MARK)}\n\n)?^{header}\n(?:\|.*\n)+",
            replacement.replace("\\", r"\\"),
            text,
            flags=re.MULTILINE,
        )
        if count != 1:
            raise ValueError(f"{name}: {count} tables begin with {table.splitlines()[0]!r}; one is needed")
    return text


if __name__ == "__main__":
    for page in PAGES:
        path = FOLDER / page
        path.write_text(laid_into(page, path.read_text()))
