"""What keys mean, as their models say it: for the reference, and for the cells that ``polishd init`` writes."""

from __future__ import annotations

import ast
import inspect
import itertools
import re
import textwrap

from pydantic import BaseModel


def meanings(model: type[BaseModel]) -> dict[str, str]:
    """The docstring below each field of the model and of those that it is made from."""
    told: dict[str, str] = {}
    for made_of in reversed(model.__mro__):
        if issubclass(made_of, BaseModel) and made_of is not BaseModel:
            body = ast.parse(textwrap.dedent(inspect.getsource(made_of))).body[0].body  # type: ignore[attr-defined]
            for field, below in itertools.pairwise(body):
                match field, below:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                        told[name] = " ".join(text.split())
    return told


def in_words(meaning: str) -> str:
    """Without the unit at its end, which the reference has in a column, and without the marks of its text."""
    return re.sub(r" \[[^]]+\]$", "", meaning).replace("``", "`")
