"""``polishd web``: serves a cell's page and HTTP API, and keeps its users."""

from __future__ import annotations

from pathlib import Path

from polishd.config.cell import load_config
from polishd.door.users import Role, UserFile, users_path
from polishd.show.terminal import say
from polishd.web.app import serve


def web_verb(cell: Path, add_user: str | None, role: Role, remove_user: str | None) -> None:
    """Add or remove a user, or serve."""
    config = load_config(cell)
    users = UserFile(users_path(config))
    if add_user is not None:
        token = users.add(add_user, role)
        say(f"{add_user} may {role.value}; the token, which is not shown again:", err=True)
        say(token)
    elif remove_user is not None:
        users.remove(remove_user)
        say(f"{remove_user} is out", err=True)
    else:
        if not users:
            say("nobody can sign in yet: polishd web CELL.toml --add-user NAME --role operate", err=True)
        serve(config)
