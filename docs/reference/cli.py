"""Write docs/reference/cli.md from the verbs and options of the command line: ``python -m docs.reference.cli``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from docs.reference.man import one_line
from polishd.cli.app import app

PAGE = Path(__file__).with_name("cli.md")
HEAD = """\
<!-- Written by `make reference` from the command line; a test fails where it differs. -->

# Command line

`polishd run` starts the daemon of a cell; the other commands make its files, or use its socket. Each command has
`--help`, and most have `--json`. Exit codes: [errors.md](errors.md). Shell completion: `polishd --install-completion`.
"""


def page() -> str:
    """Return the whole page."""
    return HEAD + "".join(_commands(typer.main.get_command(app), "polishd"))


def _commands(group: Any, path: str) -> Iterator[str]:
    for name, command in sorted(group.commands.items()):
        whole = f"{path} {name}"
        if command.hidden:
            continue
        if hasattr(command, "commands"):
            yield from _commands(command, whole)
            continue
        context = typer.Context(command, info_name=whole)
        pieces = " ".join(piece for piece in command.collect_usage_pieces(context) if piece != "[OPTIONS]")
        yield f"\n## {whole}\n\n    {whole} {pieces}".rstrip() + f"\n\n{_escaped(one_line(command.help))}\n"
        options = [param.get_help_record(context) for param in command.get_params(context) if _shown(param)]
        rows = [f"| `{one_line(one[0])}` | {_escaped(one_line(one[1]))} |\n" for one in options if one is not None]
        if rows:
            yield "\n| argument or option | meaning |\n|---|---|\n" + "".join(rows).replace("`|`", "`\\|`")


def _shown(param: Any) -> bool:
    return "--help" not in getattr(param, "opts", ())


def _escaped(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "\\<").replace("[", "\\[").replace("*", "\\*")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
