"""Names of all Python files of the tree, resolved: which token means which module or which module-level symbol."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from pathlib import Path

SKIP = {".venv", "build", "__pycache__", ".git", ".mypy_cache", ".ruff_cache", ".pytest_cache", ".hypothesis"}


@dataclass
class Scope:
    kind: str
    parent: "Scope | None"
    bindings: dict = field(default_factory=dict)  # name -> list of ('import', module, attr, stmt, alias) | ('def', node) | ('local', node)
    globals: set = field(default_factory=set)
    nonlocals: set = field(default_factory=set)


@dataclass
class Src:
    path: str
    mod: str
    pkg: bool
    text: str
    tree: ast.Module = None
    lines: list = None
    top: Scope = None
    names: list = None  # (Name node, scope)
    attrs: list = None  # (Attribute node, scope)
    imports: list = None  # (stmt, scope, depth)
    calls: list = None
    scopes: list = None
    strings: list = None


def module_name(rel: Path) -> str:
    parts = list(rel.with_suffix("").parts)
    if parts[-1] == "__init__":
        parts.pop()
    return ".".join(parts)


class Builder(ast.NodeVisitor):
    def __init__(self, src):
        self.src = src
        self.scope = src.top = Scope("module", None)
        src.names, src.attrs, src.imports, src.calls, src.strings = [], [], [], [], []
        src.scopes = [src.top]

    def bind(self, name, what, scope=None):
        scope = scope or self.scope
        if name in scope.globals:
            scope = self.src.top
        scope.bindings.setdefault(name, []).append(what)

    def push(self, kind):
        self.scope = Scope(kind, self.scope)
        self.src.scopes.append(self.scope)

    def pop(self):
        self.scope = self.scope.parent

    def args(self, a):
        for x in [*a.posonlyargs, *a.args, *a.kwonlyargs, a.vararg, a.kwarg]:
            if x is not None:
                self.bind(x.arg, ("local", x))

    def visit_FunctionDef(self, n):
        self.bind(n.name, ("def", n))
        for d in n.decorator_list:
            self.visit(d)
        a = n.args
        for x in [*a.posonlyargs, *a.args, *a.kwonlyargs, a.vararg, a.kwarg]:
            if x is not None and x.annotation is not None:
                self.visit(x.annotation)
        for x in [*a.defaults, *[k for k in a.kw_defaults if k is not None]]:
            self.visit(x)
        if n.returns is not None:
            self.visit(n.returns)
        self.push("function")
        self.args(a)
        for s in n.body:
            self.visit(s)
        self.pop()

    visit_AsyncFunctionDef = visit_FunctionDef

    def visit_Lambda(self, n):
        for x in [*n.args.defaults, *[k for k in n.args.kw_defaults if k is not None]]:
            self.visit(x)
        self.push("function")
        self.args(n.args)
        self.visit(n.body)
        self.pop()

    def visit_ClassDef(self, n):
        self.bind(n.name, ("def", n))
        for d in [*n.decorator_list, *n.bases]:
            self.visit(d)
        for k in n.keywords:
            self.visit(k.value)
        self.push("class")
        for s in n.body:
            self.visit(s)
        self.pop()

    def comp(self, n):
        self.visit(n.generators[0].iter)
        self.push("function")
        for i, g in enumerate(n.generators):
            self.visit(g.target)
            if i:
                self.visit(g.iter)
            for c in g.ifs:
                self.visit(c)
        if isinstance(n, ast.DictComp):
            self.visit(n.key)
            self.visit(n.value)
        else:
            self.visit(n.elt)
        self.pop()

    visit_ListComp = visit_SetComp = visit_GeneratorExp = visit_DictComp = comp

    def visit_NamedExpr(self, n):
        s = self.scope
        while s.kind == "function" and getattr(s, "is_comp", False):
            s = s.parent
        self.visit(n.value)
        self.visit(n.target)

    def visit_Import(self, n):
        self.src.imports.append((n, self.scope))
        for a in n.names:
            if a.asname:
                self.bind(a.asname, ("import", a.name, None, n, a))
            else:
                self.bind(a.name.split(".")[0], ("import", a.name.split(".")[0], None, n, a))

    def visit_ImportFrom(self, n):
        self.src.imports.append((n, self.scope))
        base = n.module or ""
        for a in n.names:
            self.bind(a.asname or a.name, ("import", base, a.name, n, a))

    def visit_Global(self, n):
        self.scope.globals |= set(n.names)

    def visit_Nonlocal(self, n):
        self.scope.nonlocals |= set(n.names)

    def visit_AnnAssign(self, n):
        if self.scope.kind == "class":  # never evaluated: a field may have the name of what its annotation means
            here, self.scope = self.scope, self.scope.parent
            names = len(self.src.names)
            self.visit(n.annotation)
            self.scope = here
            self.src.names[names:] = [(x, here if any(b[0] == "import" or b[0] == "def" for b in here.bindings.get(x.id, ())) else s) for x, s in self.src.names[names:]]
        else:
            self.visit(n.annotation)
        if n.value is not None:
            self.visit(n.value)
        self.visit(n.target)

    def visit_Name(self, n):
        if isinstance(n.ctx, (ast.Store, ast.Del)) and n.id not in self.scope.nonlocals:
            self.bind(n.id, ("local", n))
        self.src.names.append((n, self.scope))

    def visit_ExceptHandler(self, n):
        if n.name:
            self.bind(n.name, ("local", n))
        self.generic_visit(n)

    def visit_MatchAs(self, n):
        if n.name:
            self.bind(n.name, ("local", n))
        self.generic_visit(n)

    def visit_MatchStar(self, n):
        if n.name:
            self.bind(n.name, ("local", n))

    def visit_MatchMapping(self, n):
        if n.rest:
            self.bind(n.rest, ("local", n))
        self.generic_visit(n)

    def visit_Attribute(self, n):
        self.src.attrs.append((n, self.scope))
        self.generic_visit(n)

    def visit_Call(self, n):
        self.src.calls.append((n, self.scope))
        self.generic_visit(n)

    def visit_Constant(self, n):
        if isinstance(n.value, str):
            self.src.strings.append((n, self.scope))


def quoted_names(src):
    """Names in strings that are types: the first argument of cast, quoted annotations in subscripts."""
    return []


class Tree:
    def __init__(self, root: Path):
        self.root = root
        self.files: dict[str, Src] = {}
        for p in sorted(root.rglob("*.py")):
            rel = p.relative_to(root)
            if SKIP & set(rel.parts):
                continue
            mod = module_name(rel)
            self.files[mod] = Src(str(rel), mod, p.name == "__init__.py", p.read_text())
        for s in self.files.values():
            s.tree = ast.parse(s.text)
            s.lines = s.text.splitlines(keepends=True)
            Builder(s).visit(s.tree)

    def is_module(self, name):
        return name in self.files or any(m.startswith(name + ".") for m in ()) or name in self.packages

    @property
    def packages(self):
        if not hasattr(self, "_packages"):
            self._packages = set()
            for m in self.files:
                while "." in m:
                    m = m.rpartition(".")[0]
                    self._packages.add(m)
        return self._packages

    def real(self, module, attr, depth=0):
        """('mod', m) or ('sym', m, name) behind ``from module import attr``."""
        full = f"{module}.{attr}"
        src = self.files.get(module)
        if src is not None:
            bs = src.top.bindings.get(attr)
            if bs:
                b = next((x for x in bs if x[0] == "import"), None)
                if b is not None and depth < 8:
                    if b[2] is None:
                        return ("mod", b[1]) if self.is_module(b[1]) else None
                    if b[1].split(".")[0] in {"polishd", "tests", "benchmarks", "docs", "examples"}:
                        if (b[1], b[2]) == (module, attr):
                            return ("mod", full)
                        return self.real(b[1], b[2], depth + 1)
                    return None
                return ("sym", module, attr)
        if self.is_module(full):
            return ("mod", full)
        return ("sym", module, attr) if src is not None else None

    def lookup(self, name, scope):
        s, first = scope, True
        while s is not None:
            if name in s.globals:
                top = s
                while top.parent is not None:
                    top = top.parent
                return top, top.bindings.get(name)
            if name in s.bindings and (s.kind != "class" or first):
                return s, s.bindings[name]
            first = False
            s = s.parent
        return None, None

    def binding_target(self, src, scope, bs, name):
        b = next((x for x in bs if x[0] == "import"), None)
        if b is not None:
            if b[2] is None:
                return (("mod", b[1]) if self.is_module(b[1]) else None), b
            if self.is_module(b[1]) or b[1] in self.files:
                return self.real(b[1], b[2]), b
            return None, b
        if scope.parent is None:
            return ("sym", src.mod, name), bs[0]
        return None, bs[0]

    def resolve_name(self, src, node, scope):
        s, bs = self.lookup(node.id, scope)
        if bs is None:
            return None, None
        return self.binding_target(src, s, bs, node.id)

    def resolve(self, src, node, scope):
        if isinstance(node, ast.Name):
            return self.resolve_name(src, node, scope)[0]
        if isinstance(node, ast.Attribute):
            base = self.resolve(src, node.value, scope)
            if base and base[0] == "mod":
                return self.real(base[1], node.attr)
        return None


class Edits:
    """Replacements in one text, by (line, utf-8 column)."""

    def __init__(self, src):
        self.src = src
        self.offsets = [0]
        data = src.text.encode()
        self.data = data
        for l in data.splitlines(keepends=True):
            self.offsets.append(self.offsets[-1] + len(l))
        self.items = {}

    def pos(self, line, col):
        return self.offsets[line - 1] + col

    def put(self, start, end, new):
        old = self.items.get((start, end))
        assert old is None or old == new, (self.src.path, self.data[start:end], old, new)
        self.items[start, end] = new

    def at(self, line, col, old, new):
        start = self.pos(line, col)
        assert self.data[start : start + len(old)] == old.encode(), (self.src.path, line, col, old, self.data[start : start + 30])
        self.put(start, start + len(old.encode()), new)

    def apply(self):
        out, last = [], 0
        for (s, e), new in sorted(self.items.items()):
            assert s >= last, (self.src.path, self.data[s:e], new)
            out.append(self.data[last:s])
            out.append(new.encode())
            last = e
        out.append(self.data[last:])
        return b"".join(out).decode()
