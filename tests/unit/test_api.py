"""polishd.api: all that it promises is there, and what needs asyncio is imported only where it is asked for."""

from __future__ import annotations

import subprocess
import sys

import pytest

from polishd import api


def test_all_that_it_names_is_there() -> None:
    assert [name for name in api.__all__ if not hasattr(api, name)] == []
    assert sorted(set(api.__all__)) == sorted(api.__all__)


def test_a_misspelt_name_is_none_of_it() -> None:
    with pytest.raises(AttributeError, match=r"module 'polishd\.api' has no attribute 'PlainLine'"):
        _ = api.PlainLine


def test_commands_without_devices_import_no_transport() -> None:
    code = "import sys, polishd.api; print([name for name in sys.modules if 'drivers' in name or name == 'serial'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
