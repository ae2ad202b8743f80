"""Rules over the source of polishd. Each takes the project's root and returns what breaks it, one line each."""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.arch.source import Source, public, sources

# Third-party libraries that drivers, plugins and the daemon may name in two files each, so that they stay replaceable.
CONFINED = ("pymodbus", "serial", "can", "pluggy", "qpsolvers")
CONFINED_FILES = 2

# The physics and the nouns know no world: no I/O, no asyncio, no logging.
IMPURE_MODULES = {
    "asyncio", "concurrent", "ctypes", "http", "logging", "multiprocessing", "os", "select", "shutil", "signal",
    "socket", "sqlite3", "subprocess", "sys", "tempfile", "threading", "urllib",
}  # fmt: skip
IMPURE_CALLS = {"open", "print", "input", "np.load", "np.save", "np.loadtxt", "np.savetxt"}

BUILTIN_ERRORS = {
    name for name, value in vars(builtins).items() if isinstance(value, type) and issubclass(value, BaseException)
}


def docstrings(root: Path) -> list[str]:
    """Every public module, class, function and method says what it is."""
    return [
        source.at(node, f"{name or 'module'} has no docstring")
        for source in sources(root)
        for node, name in public(source.tree)
        if not ast.get_docstring(node)
    ]


def exceptions_at_home(root: Path) -> list[str]:
    """Exceptions are defined in model/errors.py only."""
    tree = sources(root)
    home = [source for source in tree if source.within("model/errors.py")]
    known = BUILTIN_ERRORS | {node.name for source in home for node in source.classes()}
    return [
        source.at(node, f"{node.name} is an exception: it belongs in polishd/model/errors.py")
        for source in tree
        if source not in home
        for node in source.classes()
        if any(_is_exception(ast.unparse(base).split(".")[-1], known) for base in node.bases)
    ]


def _is_exception(name: str, known: set[str]) -> bool:
    return name in known or name.endswith(("Error", "Exception"))


def confined_libraries(root: Path) -> list[str]:
    """A replaceable library is named in few files of drivers, plugins and daemon."""
    broken = []
    for library in CONFINED:
        users = [
            source.name
            for source in sources(root)
            if source.within("drivers/", "plugins/", "daemon/")
            and any(module.split(".")[0] == library for _, module in source.imports())
        ]
        if len(users) > CONFINED_FILES:
            broken.append(f"{library} is imported in {len(users)} files, at most {CONFINED_FILES}: {', '.join(users)}")
    return broken


def pure_process(root: Path) -> list[str]:
    """process/ and model/ do no I/O, no asyncio, no logging."""
    pure = [source for source in sources(root) if source.within("process/", "model/")]
    imported = [
        source.at(node, f"{module} has no place in the pure layers")
        for source in pure
        for node, module in source.imports()
        if module.split(".")[0] in IMPURE_MODULES
    ]
    called = [
        source.at(node, f"{callee}() has no place in the pure layers")
        for source in pure
        for node, callee in source.calls()
        if callee in IMPURE_CALLS
    ]
    return imported + called


def nothing_swallowed(root: Path) -> list[str]:
    """No handler of everything does nothing; nor does ``suppress(Exception)``."""
    return [message for source in sources(root) for message in _swallowed(source)]


def _swallowed(source: Source) -> list[str]:
    handlers = [
        node
        for node in ast.walk(source.tree)
        if isinstance(node, ast.ExceptHandler) and _catches_all(node.type) and all(map(_does_nothing, node.body))
    ]
    suppressors = [
        node
        for node, callee in source.calls()
        if callee in {"suppress", "contextlib.suppress"} and any(map(_catches_all, node.args))
    ]
    return [source.at(node, "an error of any kind is swallowed") for node in [*handlers, *suppressors]]


def _catches_all(caught: ast.expr | None) -> bool:
    if isinstance(caught, ast.Tuple):
        return any(map(_catches_all, caught.elts))
    return caught is None or ast.unparse(caught).split(".")[-1] in {"Exception", "BaseException"}


def _does_nothing(statement: ast.stmt) -> bool:
    if isinstance(statement, ast.Return):
        return statement.value is None or isinstance(statement.value, ast.Constant)
    if isinstance(statement, ast.Expr):
        return isinstance(statement.value, ast.Constant)
    return isinstance(statement, ast.Pass | ast.Continue | ast.Break)


def no_stray_tasks(root: Path) -> list[str]:
    """Tasks are created in a TaskGroup only: no caller awaits a bare task or receives its error.

    What must outlive the cancellation of its caller cannot be in a group: a task that its maker awaits in
    ``asyncio.shield`` is waited for, and allowed.
    """
    return [
        source.at(node, f"{callee}() outside a TaskGroup")
        for source in sources(root)
        for node, callee in source.calls()
        if _makes_bare_task(callee) and node not in _shielded(source)
    ]


def _makes_bare_task(callee: str) -> bool:
    receiver, _, method = callee.rpartition(".")
    if method == "create_task":
        return receiver in {"", "asyncio"} or "loop" in receiver.lower()
    return method == "ensure_future"


def _shielded(source: Source) -> set[ast.expr]:
    """Values of the names that a function both assigns and awaits in ``asyncio.shield(name)``."""
    found = set()
    for function in source.functions():
        nodes = list(ast.walk(function))
        awaited = {ast.unparse(node.value) for node in nodes if isinstance(node, ast.Await)}
        for node in nodes:
            if isinstance(node, ast.Assign) and f"asyncio.shield({ast.unparse(node.targets[0])})" in awaited:
                found.add(node.value)
    return found


def no_sleeping(root: Path) -> list[str]:
    """Nothing blocks in ``time.sleep`` but simulated machines, which are processes of their own."""
    tree = [source for source in sources(root) if not source.within("sim_backends/")]
    called = [(source, node) for source in tree for node, callee in source.calls() if callee == "time.sleep"]
    imported = [
        (source, node)
        for source in tree
        for node, module in source.imports()
        if module == "time" and isinstance(node, ast.ImportFrom) and any(a.name == "sleep" for a in node.names)
    ]
    return [source.at(node, "time.sleep blocks the loop") for source, node in [*called, *imported]]


def no_import_cycles(root: Path) -> list[str]:
    """No modules import each other, directly or by way of others; late imports and those for types count too."""
    known = {source.module: source for source in sources(root)}
    imports = {name: {found for found in _imported(source, known) if found != name} for name, source in known.items()}
    reached = {name: _reached(name, imports) for name in imports}
    rings = {
        frozenset({name} | {other for other in found if name in reached[other]}) for name, found in reached.items()
    }
    return sorted(
        f"{' and '.join(known[name].name for name in sorted(ring))} import each other"
        for ring in rings
        if len(ring) > 1
    )


def _imported(source: Source, known: Mapping[str, Source]) -> Iterator[str]:
    """Modules of the tree that a source imports, as modules or by what is in them."""
    for node, module in source.imports():
        names = [f"{module}.{alias.name}" for alias in node.names] if isinstance(node, ast.ImportFrom) else []
        inner = [name for name in names if name in known]
        yield from inner
        if module in known and len(inner) < max(len(names), 1):
            yield module


def _reached(start: str, imports: Mapping[str, set[str]]) -> set[str]:
    found: set[str] = set()
    waiting = [start]
    while waiting:
        new = imports[waiting.pop()] - found
        found |= new
        waiting += new
    return found


DECLARATIONS = {"DeviceType": "port", "SimDevice": "device"}
"""Calls that declare a device, with the argument that names its section."""
LISTS_OF_DEVICES = (
    "commissioning/rehearsal/draft.py",  # options that a cell's devices have otherwise in a rehearsal
    "config/simulator_cell.py",  # turns sections of a cell into those of SIM.toml, by type
    "config/simulator_devices.py",  # sections that several simulated devices share, by `kind` and `drive`
    "plugin_loader.py",  # plugin names of before, which are refused with the new ones
    "config/renamed_keys.py",  # device types of before
)
"""Files that a new device never touches, although they list devices."""


def no_lists_of_devices(root: Path) -> list[str]:
    """No collection names devices of other files: a driver and a simulated device declare themselves."""
    tree = sources(root)
    declared = {source.name: set(_declared_devices(source)) for source in tree}
    known = set().union(*declared.values())
    return [
        source.at(node, f"lists the devices {', '.join(sorted(found))}; let each declare what is needed of it")
        for source in tree
        if not source.within(*LISTS_OF_DEVICES)
        for node in source.nodes
        if len(found := (_listed(node) & known) - declared[source.name]) > 1
    ]


def _declared_devices(source: Source) -> Iterator[str]:
    """Names of devices that a file declares. A simulated device with the name of its section is no device's name."""
    for call, callee in source.calls():
        if callee in DECLARATIONS:
            named = {word.arg: word.value for word in call.keywords}
            name = named.get("name") or call.args[0]
            section = named.get(DECLARATIONS[callee]) or call.args[1]
            if isinstance(name, ast.Constant) and ast.dump(name) != ast.dump(section):
                yield str(name.value)


def _listed(node: ast.AST) -> set[str]:
    entries: list[ast.expr] = []
    if isinstance(node, ast.Dict):
        entries = [*filter(None, node.keys), *node.values]
    elif isinstance(node, ast.List | ast.Tuple | ast.Set):
        entries = node.elts
    return {entry.value for entry in entries if isinstance(entry, ast.Constant) and isinstance(entry.value, str)}


SENTENCE = re.compile(r"[^.\n]+(?:\.\w[^.\n]*)*\.\)?")


def unique_classes(root: Path) -> list[str]:
    """A public class name is used once in the package."""
    first: dict[str, str] = {}
    broken = []
    for source in sources(root):
        for node in source.tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                if node.name in first:
                    broken.append(source.at(node, f"{node.name} is also in {first[node.name]}: rename one"))
                first.setdefault(node.name, source.name)
    return broken


def one_sentence_packages(root: Path) -> list[str]:
    """The docstring of each package says in one sentence what belongs there."""
    return [
        source.at(source.tree, f"not one sentence: {text!r}")
        for source in sources(root)
        if source.name.endswith("/__init__.py") and not SENTENCE.fullmatch(text := ast.get_docstring(source.tree) or "")
    ]


RULES = (
    docstrings,
    exceptions_at_home,
    confined_libraries,
    pure_process,
    nothing_swallowed,
    no_stray_tasks,
    no_sleeping,
    no_import_cycles,
    unique_classes,
    one_sentence_packages,
    no_lists_of_devices,
)
