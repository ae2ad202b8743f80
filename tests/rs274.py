"""Programs in the default G-code dialect."""

from __future__ import annotations

from functools import partial

from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import dialect

DIALECT = dialect("rs274")
RS274 = formats.format_of(DIALECT)
read = partial(formats.read, DIALECT)
rewrite = partial(formats.rewrite, DIALECT)
