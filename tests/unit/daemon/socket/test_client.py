"""The table of verbs, and its copy in docs/reference/daemon.md."""

from __future__ import annotations

from pathlib import Path

from polishd.daemon.socket.client import VERBS, SocketCommand

DOCS = Path(__file__).resolve().parents[4] / "docs" / "reference" / "daemon.md"


def row(verb: SocketCommand) -> str:
    """As the table has it."""
    arguments = "; ".join(f"`{one.name}` ({one.kind.__name__}): {one.what}" for one in verb.arguments)
    return f"| `{verb.name}` | {verb.what} | {verb.changes} | {arguments} |"


def test_the_docs_have_every_verb_with_its_arguments() -> None:
    table = ["| verb | what | changes anything | arguments |", "|---|---|---|---|", *map(row, VERBS.values())]
    assert "\n".join(table) in DOCS.read_text(), "\n".join(table)
