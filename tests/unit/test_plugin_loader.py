"""Plugins: broken ones are refused by name and reason, others go on, and no call takes another down."""

from __future__ import annotations

from typing import Any

import pytest

from polishd import plugin_loader as plugins
from polishd.model.errors import PluginError
from polishd.model.events import PassProgressed
from polishd.plugin_loader import HOOKS, RENAMED, Hooks, installed, load_own, load_plugins

SOLVER = """
def solve(problem, within_s):
    raise ComputeError("not today")

@hookimpl
def polishd_dwell_solvers():
    return [DwellSolver("{name}", solve)]
"""

ALL = """
from pydantic import BaseModel

class Options(BaseModel):
    address: str

def build(options, context): return None
def anything(*arguments): return None

@hookimpl
def polishd_device_types(): return [DeviceType("arm", "robot", Options, build)]
@hookimpl
def polishd_program_formats(): return (ProgramFormat("rs274", anything, anything),)
@hookimpl
def polishd_surface_readers():
    return [SurfaceReader("dat", anything, anything), SurfaceReader("xyz", anything, anything)]
@hookimpl
def polishd_removal_models(): return [RemovalModel("preston", anything)]
@hookimpl
def polishd_dwell_solvers(): return [DwellSolver("qp", anything)]
@hookimpl
def polishd_notifiers(): return [NotifierType("pager", Options, build)]
@hookimpl
def polishd_check_plan(plan, envelope): return [f"{plan} in {envelope}"]
@hookimpl
def polishd_on_event(event): EVENTS.append(event.name)
@hookimpl
def polishd_cli(app): app.append("verb")
EVENTS = []
"""


def reason(hooks: Hooks, name: str) -> str:
    (found,) = [refused.reason for refused in hooks.report.refused if refused.name == name]
    return found


def checks(hooks: Hooks) -> list[str]:
    plan: Any = "plan"
    envelope: Any = "envelope"
    return hooks.check_plan(plan, envelope)


def test_every_hook_is_called(install: Any) -> None:
    hooks = load_plugins([install("all", ALL)])
    assert hooks.report.refused == ()
    (loaded,) = hooks.report.loaded
    assert (loaded.name, loaded.distribution, loaded.version) == ("all", "polishd-all", "1.2")
    assert all(loaded.implements(hook) for hook in HOOKS)
    assert hooks.device_types()["arm"].port == "robot"
    assert list(hooks.program_formats()) == ["rs274"]
    assert list(hooks.surface_readers()) == ["dat", "xyz"]
    assert list(hooks.removal_models()) == ["preston"]
    assert list(hooks.dwell_solvers()) == ["qp"]
    assert list(hooks.notifiers()) == ["pager"]
    assert checks(hooks) == ["all: plan in envelope"]
    app: list[str] = []
    hooks.cli(app)
    hooks.on_event(PassProgressed(block=1))
    assert app == ["verb"]
    hooks.report.require()


def test_only_named_plugins_are_imported(install: Any) -> None:
    install("bomb", "raise SystemExit('imported')")
    hooks = load_plugins([install("good", SOLVER.format(name="mine"))])
    assert [plugin.name for plugin in hooks.report.loaded] == ["good"]
    assert hooks.report.refused == ()
    assert installed()["bomb"] == ["polishd-bomb"]


BROKEN = {
    "import_error": ("import no_such_module_anywhere", "No module named 'no_such_module_anywhere'"),
    "syntax": ("def (:", "SyntaxError"),
    "exits": ("raise SystemExit(3)", "SystemExit: 3"),
    "raises": ("1 / 0", "ZeroDivisionError: division by zero"),
    "misspelt": (
        "@hookimpl\ndef polishd_dwel_solvers(): return []",
        "is not a hook; did you mean 'polishd_dwell_solvers'?",
    ),
    "misspelt_unmarked": ("def polishd_on_events(event): pass", "polishd_on_events is not a hook; did you mean"),
    "marked_stranger": (
        "@hookimpl\ndef something(): return []",
        "something is not a hook. Hooks: 'polishd_check_plan'",
    ),
    "unmarked": ("def polishd_on_event(event): pass", "polishd_on_event is not marked. Put @hookimpl"),
    "arguments": ("@hookimpl\ndef polishd_on_event(evnt): pass", "evnt"),
    "declares_nothing": ("@hookimpl\ndef polishd_dwell_solvers(): pass", "polishd_dwell_solvers returned None"),
    "declares_one": (
        "@hookimpl\ndef polishd_dwell_solvers(): return DwellSolver('x', print)",
        "must return a list of DwellSolver, not DwellSolver",
    ),
    "declares_other": (
        "@hookimpl\ndef polishd_dwell_solvers(): return [RemovalModel('x', print)]",
        "polishd_dwell_solvers must return DwellSolver, not RemovalModel",
    ),
    "declares_unnamed": (
        "@hookimpl\ndef polishd_dwell_solvers(): return [DwellSolver('', print)]",
        "DwellSolver.name must be a word, not ''",
    ),
    "declares_twice": (
        "@hookimpl\ndef polishd_dwell_solvers(): return [DwellSolver('x', print), DwellSolver('x', print)]",
        "polishd_dwell_solvers declares 'x' twice",
    ),
    "declares_port": (
        "@hookimpl\ndef polishd_device_types(): return [DeviceType('x', 'laser', dict, print)]",
        "device type 'x': port 'laser' does not exist; ports: 'actuator'",
    ),
    "declares_options": (
        "@hookimpl\ndef polishd_device_types(): return [DeviceType('x', 'robot', dict, print)]",
        "device type 'x': options must be a pydantic model",
    ),
    "declares_notifier": (
        "@hookimpl\ndef polishd_notifiers(): return [NotifierType('x', dict, print)]",
        "notifier type 'x': options must be a pydantic model",
    ),
    "declaring_raises": ("@hookimpl\ndef polishd_dwell_solvers(): return 1 / 0", "ZeroDivisionError"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_plugin_is_named_with_its_reason_and_others_go_on(install: Any, name: str) -> None:
    source, expected = BROKEN[name]
    names = [
        install("before", SOLVER.format(name="one")),
        install(name, source),
        install("after", SOLVER.format(name="two")),
    ]
    hooks = load_plugins(names)
    assert expected in reason(hooks, name)
    assert list(hooks.dwell_solvers()) == ["one", "two"]
    with pytest.raises(PluginError, match=f"^plugin '{name}' refused: "):
        hooks.report.require()


@pytest.mark.parametrize(
    ("api", "expected"),
    [
        (None, "does not state its API version. Add POLISHD_API = 1"),
        (2, "was written for API 2, this polishd has API 1"),
        ("1", "was written for API '1'"),
        (True, "was written for API True"),
    ],
)
def test_wrong_api_version(install: Any, api: Any, expected: str) -> None:
    hooks = load_plugins([install("old", SOLVER.format(name="x"), api=api)])
    assert expected in reason(hooks, "old")


def test_unknown_name(install: Any) -> None:
    install("spindle_x", "")
    hooks = load_plugins(["spindel_x"])
    assert reason(hooks, "spindel_x").startswith("it is not installed; did you mean 'spindle_x'? Installed: ")


def test_name_registered_by_two_distributions(install: Any) -> None:
    install("twin", SOLVER.format(name="a"), distribution="dist-one")
    install("twin", SOLVER.format(name="b"), distribution="dist-two")
    hooks = load_plugins(["twin", install("other", SOLVER.format(name="c"))])
    assert reason(hooks, "twin") == (
        "more than one distribution registers that name ('dist-one', 'dist-two'). Uninstall all but one."
    )
    assert list(hooks.dwell_solvers()) == ["c"]


def test_record_name_that_an_earlier_plugin_has(install: Any) -> None:
    names = [install("first", SOLVER.format(name="qp")), install("second", SOLVER.format(name="qp"))]
    hooks = load_plugins(names)
    assert [plugin.name for plugin in hooks.report.loaded] == ["first"]
    assert reason(hooks, "second").startswith("polishd_dwell_solvers: plugin 'first' already has 'qp'")


def test_all_refused_are_reported(install: Any) -> None:
    with pytest.raises(PluginError) as caught:
        load_plugins(["no_a", "no_b"]).report.require()
    assert [line.split("'")[1] for line in str(caught.value).splitlines()] == ["no_a", "no_b"]


JUDGE = "@hookimpl\ndef polishd_check_plan(plan, envelope): {body}"


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("return []", []),
        ("return ()", []),
        ("return ['too fast', 'too far']", ["judge: too fast", "judge: too far"]),
        ("return 'too fast'", ["judge: too fast"]),
        ("return None", ["judge: returned None instead of a list of violations"]),
        ("return True", ["judge: returned bool instead of a list of violations"]),
        ("return [3]", ["judge: returned list instead of a list of violations"]),
        ("raise ValueError('oh')", ["judge: raised ValueError: oh"]),
    ],
)
def test_plan_is_refused_by_anything_but_an_empty_list(install: Any, body: str, expected: list[str]) -> None:
    names = [
        install("judge", JUDGE.format(body=body)),
        install("mild", JUDGE.format(body="return []")),
        install("strict", JUDGE.format(body="return ['never']")),
        install("silent", SOLVER.format(name="x")),
    ]
    assert checks(load_plugins(names)) == [*expected, "strict: never"]


def test_events_reach_all_though_one_raises(install: Any, caplog: pytest.LogCaptureFixture) -> None:
    received: list[str] = []
    listen = "EVENTS = []\n@hookimpl\ndef polishd_on_event(event): EVENTS.append(event.name)"
    names = [
        install("one", listen),
        install("two", "@hookimpl\ndef polishd_on_event(event): raise RuntimeError('oh')"),
        install("three", listen),
    ]
    hooks = load_plugins(names)
    hooks.on_event(PassProgressed(block=1))
    for plugin in hooks.report.loaded:
        (registered,) = plugin.manager.get_plugins()
        received += getattr(registered, "EVENTS", [])
    assert received == ["pass_progressed", "pass_progressed"]
    assert "plugin two failed on event pass_progressed" in caplog.text
    assert "RuntimeError: oh" in caplog.text


def test_slow_listener_is_named(
    install: Any, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plugins, "SLOW_S", -1.0)
    caplog.set_level("INFO")
    load_plugins([install("slow", "@hookimpl\ndef polishd_on_event(event): pass")]).on_event(PassProgressed(block=1))
    assert "plugin slow took 0.0 s for event pass_progressed" in caplog.text


def test_commands_are_added_though_one_raises(install: Any, caplog: pytest.LogCaptureFixture) -> None:
    names = [
        install("one", "@hookimpl\ndef polishd_cli(app): raise RuntimeError('oh')"),
        install("two", "@hookimpl\ndef polishd_cli(app): app.append('two')"),
    ]
    app: list[str] = []
    load_plugins(names).cli(app)
    assert app == ["two"]
    assert "plugin one failed to add its commands" in caplog.text


def test_interrupt_is_never_swallowed(install: Any) -> None:
    hooks = load_plugins([install("one", "@hookimpl\ndef polishd_on_event(event): raise KeyboardInterrupt")])
    with pytest.raises(KeyboardInterrupt):
        hooks.on_event(PassProgressed(block=1))


def test_own_plugins_only(install: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stranger that registers one of our names does not even make ours ambiguous."""
    monkeypatch.setattr(plugins, "OWN", "house")
    install("mine", SOLVER.format(name="ours"), distribution="house")
    install("mine", SOLVER.format(name="theirs"), distribution="stranger")
    install("other", "raise SystemExit('imported')", distribution="stranger")
    hooks = load_own()
    assert [(plugin.name, plugin.distribution) for plugin in hooks.report.loaded] == [("mine", "house")]
    assert list(hooks.dwell_solvers()) == ["ours"]
    assert hooks.report.refused == ()


def test_plugin_may_use_polishd_names_that_are_no_functions(install: Any) -> None:
    source = "import polishd.api as polishd_api\npolishd_version = 3\nclass polishd_Thing: pass\n"
    hooks = load_plugins([install("fine", source)])
    assert hooks.report.refused == ()


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_an_old_name_is_refused_with_the_new_one(old: str, new: str) -> None:
    assert repr(new) in reason(load_plugins([old]), old)
    assert new in installed()
