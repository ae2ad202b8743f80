"""The rules themselves: each one fails on a small bad tree, and passes on a good one beside it."""

from __future__ import annotations

import subprocess
from pathlib import Path
from textwrap import dedent

import pytest

from tests.arch import code_rules as code
from tests.arch import repository_rules as repository
from tests.arch import words
from tests.arch.source import Rule

HASH = "--hash=sha256:" + "0" * 64


def grow(root: Path, files: dict[str, str]) -> Path:
    """A tree of these files; text is dedented."""
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(dedent(text))
    return root


# rule, file, text that breaks it, text that does not
CASES: list[tuple[Rule, str, str, str]] = [
    (code.docstrings, "polishd/a.py", "x = 1\n", '"""Module."""\n'),
    (code.docstrings, "polishd/a.py", '"""M."""\ndef f(): ...\n', '"""M."""\ndef _f(): ...\n'),
    (code.docstrings, "polishd/a.py", '"""M."""\nclass A: ...\n', '"""M."""\nclass _A:\n    def f(self): ...\n'),
    (
        code.docstrings,
        "polishd/a.py",
        '"""M."""\nclass A:\n    """A."""\n    async def f(self): ...\n',
        '"""M."""\nclass A:\n    """A."""\n    def __len__(self): ...\n',
    ),
    (
        code.docstrings,
        "polishd/a.py",
        '"""M."""\nif 1:\n    def f(): ...\n',
        '"""M."""\ndef f():\n    """F."""\n    def g(): ...\n',
    ),
    (code.unique_classes, "polishd/a.py", "class A: ...\nclass A: ...\n", "class A: ...\nclass B: ...\n"),
    (
        code.one_sentence_packages,
        "polishd/a/__init__.py",
        '"""One. Two."""\n',
        '"""Drivers (docs/how-to/drivers.md)."""\n',
    ),
    (code.exceptions_at_home, "polishd/a.py", "class A(ValueError): ...\n", "class A(dict): ...\n"),
    (code.exceptions_at_home, "polishd/a.py", "class A(errors.LinkError): ...\n", "class A(errors.Link): ...\n"),
    (code.pure_process, "polishd/process/a.py", "import asyncio\n", "import numpy\n"),
    (code.pure_process, "polishd/model/a.py", "from logging import getLogger\n", "import math\n"),
    (code.pure_process, "polishd/process/a.py", "open('x')\n", "opened('x')\n"),
    (code.pure_process, "polishd/process/a.py", "def f():\n    import subprocess\n", "def f():\n    import math\n"),
    (code.nothing_swallowed, "polishd/a.py", "try: f()\nexcept: pass\n", "try: f()\nexcept: raise\n"),
    (code.nothing_swallowed, "polishd/a.py", "try: f()\nexcept Exception: ...\n", "try: f()\nexcept OSError: ...\n"),
    (
        code.nothing_swallowed,
        "polishd/a.py",
        "try: f()\nexcept (OSError, BaseException): pass\n",
        "try: f()\nexcept Exception as e: log(e)\n",
    ),
    (
        code.nothing_swallowed,
        "polishd/a.py",
        "def g():\n    try: f()\n    except Exception: return None\n",
        "def g():\n    try: f()\n    except Exception: return cleaned()\n",
    ),
    (
        code.nothing_swallowed,
        "polishd/a.py",
        "with contextlib.suppress(Exception): f()\n",
        "with suppress(OSError): f()\n",
    ),
    (code.no_stray_tasks, "polishd/a.py", "asyncio.create_task(f())\n", "group.create_task(f())\n"),
    (code.no_stray_tasks, "polishd/a.py", "create_task(f())\n", "self.group.create_task(f())\n"),
    (code.no_stray_tasks, "polishd/a.py", "asyncio.get_running_loop().create_task(f())\n", "x = asyncio.TaskGroup()\n"),
    (code.no_stray_tasks, "polishd/a.py", "asyncio.ensure_future(f())\n", "asyncio.timeout(1)\n"),
    (
        code.no_stray_tasks,
        "polishd/a.py",
        "async def f():\n    t = asyncio.ensure_future(g())\n    await asyncio.shield(u)\n",
        "async def f():\n    t = asyncio.ensure_future(g())\n    await asyncio.shield(t)\n",
    ),
    (code.no_sleeping, "polishd/a.py", "time.sleep(1)\n", "asyncio.sleep(1)\n"),
    (code.no_sleeping, "polishd/a.py", "from time import sleep\n", "from time import monotonic\n"),
    (code.no_sleeping, "polishd/drivers/a.py", "import time\ntime.sleep(1)\n", "import time\n"),
    (
        repository.lock_is_complete,
        "requirements.lock",
        f"a==1 \\\n    {HASH}\nb==1\n",
        f"a==1 ; x == 'y' \\\n    {HASH}\n",
    ),
    (repository.lock_is_complete, "requirements.lock", f"a>=1 {HASH}\n", f"a[b]==1 {HASH}\n    # via c\n"),
    (repository.lock_is_complete, "requirements.lock", "# nothing\n", f"a==1 {HASH}\n"),
    (repository.lock_is_complete, "requirements.lock", f"a==1 {HASH[:-1]}\n", f"a==1 {HASH}\n"),
    (repository.lock_names_no_place, "requirements.lock", "--index-url x\n", f"a==1 {HASH}\n"),
    (repository.lock_names_no_place, "requirements.lock", "a @ https://host/a.whl\n", f"a==1 {HASH}\n"),
    (repository.lock_names_no_place, "requirements.lock", "# made in /somewhere\n", "# via a\n"),
]


@pytest.mark.parametrize(("rule", "name", "bad", "good"), CASES, ids=[rule.__name__ for rule, *_ in CASES])
def test_a_rule_tells_good_from_bad(tmp_path: Path, rule: Rule, name: str, bad: str, good: str) -> None:
    assert rule(grow(tmp_path / "bad", {name: bad}))
    assert not rule(grow(tmp_path / "good", {name: good}))


def test_every_rule_is_tried() -> None:
    tried = {case[0] for case in CASES}
    alone = {
        code.confined_libraries,
        code.no_import_cycles,
        code.no_lists_of_devices,
        repository.no_machine_named,
        repository.hooks_are_documented,
        repository.hooks_are_tested,
    }
    assert {*code.RULES, *repository.RULES} == tried | alone


def test_a_violation_names_its_place(tmp_path: Path) -> None:
    grow(tmp_path, {"polishd/a/b.py": "import time\n\ntime.sleep(1)\n"})
    assert code.no_sleeping(tmp_path) == ["polishd/a/b.py:3: time.sleep blocks the loop"]


def test_simulated_machines_may_sleep(tmp_path: Path) -> None:
    assert not code.no_sleeping(grow(tmp_path, {"polishd/sim_backends/a.py": "time.sleep(1)\n"}))


def test_modules_that_import_each_other_are_found(tmp_path: Path) -> None:
    """By name, by what is in them, late, and by way of others; what a package imports of its modules is no cycle."""
    grow(
        tmp_path,
        {
            "polishd/__init__.py": "",
            "polishd/a.py": "from polishd import b\n",
            "polishd/b.py": "import polishd.c\n",
            "polishd/c.py": "def f():\n    from polishd.a import g\n",
            "polishd/d/__init__.py": "from polishd.d.e import f\n",
            "polishd/d/e.py": "from polishd.d.g import f\nfrom polishd import a\n",
            "polishd/d/g.py": "import polishd.d.g\n",
        },
    )
    ring = "polishd/a.py and polishd/b.py and polishd/c.py import each other"
    assert code.no_import_cycles(tmp_path) == [ring]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('SPEED = {"arm": 1.0, "gantry": 4.0}\n', True),
        ('KIND = Literal["arm", "sim_arm"]\n', True),
        ('KINDS = ["robot", "arm"]\n', False),
        ('KINDS = ["robot", "loader"]\n', False),
    ],
)
def test_a_list_of_devices_is_found(tmp_path: Path, text: str, found: bool) -> None:
    """Device types and simulated devices count, and sections do not; nor does what declares them."""
    grow(
        tmp_path,
        {
            "polishd/drivers/a.py": """
                NAMES = ["arm", "gantry"]
                DeviceType("arm", "robot")
                DeviceType("gantry", port="robot")
            """,
            "polishd/sim_backends/a.py": """
                SimDevice(name="sim_arm", device="robot")
                SimDevice(name="loader", device="loader")
            """,
            "polishd/b.py": text,
        },
    )
    assert [line.partition(":")[0] for line in code.no_lists_of_devices(tmp_path)] == ["polishd/b.py"] * found


def test_a_private_phrase_is_found_with_its_place(tmp_path: Path) -> None:
    files = {"polishd/a.py": "# Nobody\n# is told_s\n# heard\n", "docs/a.md": "It is told.\n"}
    files |= {"tests/a.py": "# it heard\n", "tests/a.js": "// told\n", "tests/campaigns/pits/a.py": "# told\n"}
    grow(tmp_path, files)
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    found = sorted(line.rpartition(": ")[0] for line in words.plain_words(tmp_path))
    assert found == ["docs/a.md:1: 'told'", "polishd/a.py:1: 'Nobody'", "tests/a.py:1: 'heard'"]


def test_errors_may_be_defined_at_home(tmp_path: Path) -> None:
    home = {"polishd/model/errors.py": "class Bad(Exception): ...\nclass Worse(Bad): ...\n"}
    assert not code.exceptions_at_home(grow(tmp_path / "good", home))
    assert code.exceptions_at_home(grow(tmp_path / "bad", {**home, "polishd/a.py": "class Worst(Bad): ...\n"}))


def test_the_impure_layers_may_do_input_and_output(tmp_path: Path) -> None:
    assert not code.pure_process(grow(tmp_path, {"polishd/daemon/a.py": "import asyncio\nopen('x')\n"}))


def test_a_confined_library_has_two_homes(tmp_path: Path) -> None:
    users = {
        "polishd/drivers/a.py": "import serial\n",
        "polishd/plugins/b.py": "from serial.tools import list_ports\n",
        "polishd/api.py": "import serial\n",
        "polishd/daemon/c.py": "import serialised\n",
    }
    assert not code.confined_libraries(grow(tmp_path / "two", users))
    broken = code.confined_libraries(grow(tmp_path / "three", {**users, "polishd/daemon/c.py": "import serial\n"}))
    assert len(broken) == 1
    assert "serial is imported in 3 files" in broken[0]


def test_no_rule_passes_on_nothing(tmp_path: Path) -> None:
    (tmp_path / "polishd").mkdir()
    for rule in code.RULES:
        with pytest.raises(AssertionError, match="no Python files"):
            rule(tmp_path)


HOOKS = {"polishd/hookspecs.py": "def polishd_tea(): ...\ndef polishd_on_tea(): ...\ndef helper(): ...\n"}


def test_hooks_must_be_in_the_guide(tmp_path: Path) -> None:
    guide = {"docs/how-to/plugins.md": "- `polishd_tea`: makes tea\n"}
    assert len(repository.hooks_are_documented(grow(tmp_path / "none", HOOKS))) == 2
    broken = repository.hooks_are_documented(grow(tmp_path / "one", {**HOOKS, **guide}))
    assert broken == ["docs/how-to/plugins.md: polishd_on_tea is not mentioned"]
    guide["docs/how-to/plugins.md"] += "- `polishd_on_tea`: hears of it\n"
    assert not repository.hooks_are_documented(grow(tmp_path / "both", {**HOOKS, **guide}))


def test_hooks_must_be_in_a_test(tmp_path: Path) -> None:
    tests = {"tests/unit/test_a.py": "x.polishd_tea()\n", "tests/arch/test_b.py": "x.polishd_on_tea()\n"}
    broken = repository.hooks_are_tested(grow(tmp_path, {**HOOKS, **tests}))
    assert broken == ["tests/: polishd_on_tea is named by no test"]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("see {root}/docs", True),
        ("cd /{}/me/polishd".format("home"), True),
        ("/{}/.cache".format("root"), True),
        (r"C:\{}\me".format("Users"), True),
        ("https://{}.org/simple".format("pypi"), True),
        ("https://files.{}.org".format("pythonhosted"), True),
        ("/etc/polishd/cell.toml and /dev/ttyUSB0", False),
        ("https://example.org/home/index.html", False),
        ("docs/rooted/plan.md", False),
    ],
)
def test_machines_and_registries_are_not_named(tmp_path: Path, text: str, named: bool) -> None:
    grow(tmp_path, {"README.md": text.replace("{root}", str(tmp_path)), ".gitignore": "build/\n"})
    grow(tmp_path, {"build/log": f"built in {tmp_path}/"})  # not tracked, so not judged
    subprocess.run(["git", "init", "--quiet", str(tmp_path)], check=True)
    assert bool(repository.no_machine_named(tmp_path)) == named
