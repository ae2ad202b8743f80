"""The class of all command groups: panels and options of the help, new names of renamed commands, completion."""

from __future__ import annotations

import copy
import os
import re
import shutil
from functools import partial
from typing import Any

import typer.core
from typer._click.exceptions import MissingParameter, UsageError

from polishd.cli.completion import complete

_MARKUP = re.compile(r"(?<!\\)\[(?=[a-z#/@])")
"""Text that rich would read as the beginning of a tag."""
NARROW = 80
"""Below so many columns the help has no separate column for units and choices."""
RENAMED_COMMANDS = {
    "job": "queue",
    "beliefs": "estimates show",
    "record": "recording",
    "calibrate cell": "calibrate first-touch",
    "device find": "device scan",
    "estimates": "estimates show|forget",
    "shop lessons": "shop estimates",
    "shop link": "shop connect",
    "report": "certificate",
    "report certificate": "certificate make",
    "report key": "certificate keygen",
    "report keygen": "certificate keygen",
    "report schema": "certificate schema",
    "report verify": "certificate verify",
    "version": "--version",
    "completion": "--install-completion",
}
"""Commands of before release 1.0. A renamed group with an unknown command is found by the group alone."""
PLAIN_ERRORS = (
    (r"^Value error, ('.*?') is not one of (.*)", r"\1 is not allowed. Use one of \2"),
    (r"^Input should be a valid number.*", "must be a number"),
    (r"^Input should be a valid integer.*", "must be a whole number"),
    (r"^Input should be greater than or equal to ", "must be at least "),
    (r"^Input should be less than or equal to ", "must be at most "),
    (r"^Input should be (greater|less) than ", r"must be \1 than "),
)
"""Messages of pydantic for the value of an option, and the same in the words of ``config.toml_loader``."""
MOST_NAMED = 12
"""In groups with at most so many commands, the message for an unknown one names them all."""


class CommandGroup(typer.core.TyperGroup):
    """A group of commands. Help text has no markup, so that ``polishd[testing]`` is shown whole."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """See TyperGroup."""
        found = super().get_command(ctx, cmd_name)
        if found is not None:
            _prepare(found)
        return found

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """See TyperGroup. UsageError with the new name for a command that was renamed."""
        if args and args[0] not in self.commands:
            group = _path(ctx)
            path = f"{group} {args[0]}".strip()
            for name in (" ".join([path, *args[1:2]]), path, group):
                if (new := RENAMED_COMMANDS.get(name)) is not None:
                    ctx.fail(f"'polishd {name}' was renamed. Use 'polishd {new}'.")
        try:
            return super().resolve_command(ctx, args)
        except UsageError as error:
            if "Did you mean" not in error.message and len(self.commands) <= MOST_NAMED:
                error.message += f" Use one of {', '.join(self.list_commands(ctx))}."
            raise

    def invoke(self, ctx: Any) -> Any:
        """See TyperGroup. Wrong values of options are reported in plain words."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            for pattern, plain in PLAIN_ERRORS:
                error.message = re.sub(pattern, plain, error.message, flags=re.DOTALL)
            switch = error.param
            off = getattr(switch, "secondary_opts", ())
            if isinstance(error, MissingParameter) and switch is not None and off:
                names = " or ".join([*switch.opts, *off])
                raise UsageError(f"Missing option. Add {names}.", error.ctx) from None
            raise

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """See TyperGroup."""
        _format_help(self, ctx, formatter)


def _path(ctx: Any) -> str:
    """Return the names of the groups below ``polishd``, which may itself be ``python -m polishd``."""
    return "" if ctx.parent is None else f"{_path(ctx.parent)} {ctx.info_name}".strip()


def _prepare(command: Any) -> None:
    """Complete a command's arguments by their metavars, and escape markup in help texts; also of commands below it."""
    for one in (command, *command.params):
        text = getattr(one, "help", None)
        if isinstance(text, str):
            one.help = _MARKUP.sub(r"\\[", text)
    for param in command.params:
        param.shell_complete = partial(complete, param)
        param.process_value = partial(_process_value, param)
        if (descriptor := getattr(param, "type_descriptor", None)) is not None:
            descriptor.parameter_info.readable = False  # the command refuses such a file as a missing one, with JSON
    command.format_help = partial(_format_help, command)
    for below in getattr(command, "commands", {}).values():
        _prepare(below)


def _process_value(param: Any, ctx: Any, value: Any) -> Any:
    """See TyperOption. BadParameter for a file or folder with an empty name, which would be the present folder."""
    if param.type_descriptor.is_path and "" in (value if isinstance(value, (list, tuple)) else [value]):
        raise typer.BadParameter("the name is empty; name a file or folder", ctx=ctx, param=param)
    return type(param).process_value(param, ctx, value)


def _format_help(command: Any, ctx: Any, _formatter: Any) -> None:
    """Print the help of a command. Flags and files have no type; in a narrow terminal the types go into the text."""
    from typer import rich_utils

    narrow = shutil.get_terminal_size().columns < NARROW
    shown = copy.copy(command)
    shown.params = [_shown(param, ctx, narrow=narrow) for param in command.get_params(ctx)]
    shown.add_help_option = False  # it is among the parameters
    rich_utils.rich_format_help(obj=shown, ctx=ctx, markup_mode=command.rich_markup_mode)


def _shown(param: Any, ctx: Any, *, narrow: bool) -> Any:
    """Return a copy of a parameter as the help shows it."""
    shown = copy.copy(param)
    shown.help = (param.help or "").removesuffix(".")
    is_choice = param.type_descriptor.is_choice
    hidden = param.is_flag if param.param_type_name == "option" else not is_choice
    kind = "" if hidden else param.display_type_rich(ctx)
    if narrow and kind:
        between = param._get_number_range_help_str()
        choices = kind.strip("<>").replace("|", ", ") if is_choice and param.metavar is None else kind
        shown.help = f"{choices}{f', {between}' if between else ''}: {shown.help}"
        shown._get_number_range_help_str = lambda: None
        kind = ""
    shown.display_type_rich = lambda **_: kind
    return shown


def yield_to_daemon() -> None:
    """Give the process of this command a lower priority than the daemon, whose loop controls contact."""
    os.nice(5)
