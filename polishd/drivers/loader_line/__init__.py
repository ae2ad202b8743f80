"""A part loader on numbered ASCII lines: docs/protocols/loader.md."""

from polishd.drivers.loader_line.driver import LoaderLine

__all__ = ["LoaderLine"]
