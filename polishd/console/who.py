"""Who sits at the terminal: for the journal, which names whoever gives an order."""

from __future__ import annotations

import os
import pwd


def account(number: int) -> str:
    """The name of an account; its number where it has none here."""
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:  # of a folder from another computer
        return str(number)


def at_the_terminal() -> str:
    """The present account, and that it spoke at a terminal."""
    return f"{account(os.getuid())} (command line)"
