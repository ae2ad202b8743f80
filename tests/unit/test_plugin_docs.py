"""docs/how-to/plugins.md: each example is accepted by the real loader, and each hook has one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from polishd.config.cell import PORTS
from polishd.daemon.cell.device_polling import missing_members
from polishd.hookspecs import DeviceContext
from polishd.plugin_loader import DECLARATIONS, HOOKS, load_plugins

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "plugins.md").read_text()
SECTIONS = dict(re.findall(r"^### `(polishd_\w+)\((.*?)(?=^### |\Z)", TEXT, re.DOTALL | re.MULTILINE))
EXAMPLES = {
    name: re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE) for name, text in SECTIONS.items()
}


def test_every_hook_is_documented_with_an_example() -> None:
    assert set(SECTIONS) == HOOKS
    assert all(len(found) == 1 for found in EXAMPLES.values())


@pytest.mark.parametrize("hook", sorted(EXAMPLES))
def test_example_is_accepted_and_has_its_hook(install: Any, hook: str) -> None:
    (source,) = EXAMPLES[hook]
    assert "POLISHD_API = 1\n" in source
    hooks = load_plugins([install("example", source, api=None)])
    assert hooks.report.refused == ()
    (plugin,) = hooks.report.loaded
    assert plugin.implements(hook)
    assert all(len(plugin.records[name]) == (name == hook) for name in DECLARATIONS)


def test_the_device_has_all_that_its_port_asks(install: Any, tmp_path: Path) -> None:
    (source,) = EXAMPLES["polishd_device_types"]
    (kind,) = load_plugins([install("box", source, api=None)]).device_types().values()
    device = kind.build(kind.options(folder="maps"), DeviceContext(tmp_path, tmp_path, "P-1", ()))
    assert missing_members(device, PORTS[kind.port].protocol) == []


def test_frame_is_accepted(install: Any) -> None:
    (frame,) = re.findall(r"^```python\n(# polishd_acme.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
    load_plugins([install("acme", frame, api=None)]).report.require()


def test_documented_signatures_are_the_hooks(install: Any) -> None:
    from polishd import hookspecs

    for hook, text in SECTIONS.items():
        names = [name.strip() for name in text.split(")")[0].split(",") if name.strip()]
        code = getattr(hookspecs, hook).__code__
        assert names == list(code.co_varnames[: code.co_argcount]), hook
