"""Rename module-level symbols everywhere: rename.py ROOT TABLE (lines: module.name new). Writes in place."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

from analysis import Edits, Tree

SETTERS = {"setattr", "getattr", "delattr", "hasattr", "object"}


def def_site(src, node):
    """(line, col) of the name of a def or class."""
    line = node.lineno
    col = node.col_offset
    raw = src.lines[line - 1].encode()[col:].decode()
    m = re.match(r"(async\s+def|def|class)\s+", raw)
    return line, col + len(m.group(0).encode())


def rename(root: Path, table: dict[tuple[str, str], str], docs: bool = True) -> list[str]:
    tree = Tree(root)
    report = []
    for key in list(table):
        if key[0] not in tree.files or key[1] not in tree.files[key[0]].top.bindings:
            report.append(f"no such symbol: {key[0]}.{key[1]} -> {table.pop(key)}")
    by_old: dict[str, set] = {}
    for (m, n), new in table.items():
        by_old.setdefault(n, set()).add(new)
    # what each name may be at module level all over polishd: to decide on prose
    owners: dict[str, set] = {}
    for s in tree.files.values():
        if s.mod.split(".")[0] == "polishd":
            for n, bs in s.top.bindings.items():
                if any(b[0] != "import" for b in bs):
                    owners.setdefault(n, set()).add(s.mod)
    for src in tree.files.values():
        ed = Edits(src)
        new_of: dict = {}  # local binding -> new name
        clash: set = set()
        # imports that bind a renamed symbol without an alias
        taken = {n for sc in src.scopes for n in sc.bindings} | {n.id for n, _ in src.names}
        changed_imports = {}
        for stmt, scope in src.imports:
            if not isinstance(stmt, ast.ImportFrom):
                continue
            for a in stmt.names:
                r = tree.real(stmt.module or "", a.name) if tree.is_module(stmt.module or "") else None
                if not r or r[0] != "sym" or r[1:] not in table:
                    continue
                new = table[r[1:]]
                if a.name != r[2]:
                    report.append(f"{src.path}:{a.lineno}: {a.name} is imported under another name by a facade")
                    continue
                if a.asname and a.asname == a.name:  # `X as X`: exported again
                    raw = src.lines[a.lineno - 1].encode()[a.col_offset :].decode()
                    ed.at(a.lineno, a.col_offset, re.match(rf"{a.name}\s+as\s+{a.name}", raw).group(0), f"{new} as {new}")
                    changed_imports[id(a)] = new
                elif a.asname:
                    ed.at(a.lineno, a.col_offset, a.name, new)
                    if a.asname == new:
                        raw = src.lines[a.lineno - 1]
                        m = re.match(rf"{a.name}(\s+as\s+{a.asname})", raw.encode()[a.col_offset :].decode())
                        ed.at(a.lineno, a.col_offset + len(a.name), m.group(1), "")
                elif new in taken and not _same(tree, src, scope, new, r):
                    ed.at(a.lineno, a.col_offset, a.name, f"{new} as {a.name}")
                    report.append(f"{src.path}:{a.lineno}: {new} is taken, kept {a.name}")
                    clash.add(id(a))
                else:
                    ed.at(a.lineno, a.col_offset, a.name, new)
                    changed_imports[id(a)] = new
        # definitions in this module
        mine = {n: new for (m, n), new in table.items() if m == src.mod}
        for n, new in mine.items():
            if new in src.top.bindings and new not in mine:
                report.append(f"{src.path}: {new} exists already beside {n}")
            for b in src.top.bindings[n]:
                if b[0] == "def":
                    line, col = def_site(src, b[1])
                    ed.at(line, col, n, new)
        for node, scope in src.names:
            s, bs = tree.lookup(node.id, scope)
            if bs is None:
                continue
            target, b = tree.binding_target(src, s, bs, node.id)
            if not target or target[0] != "sym" or target[1:] not in table:
                continue
            if b[0] == "import":
                if id(b[4]) in changed_imports:
                    ed.at(node.lineno, node.col_offset, node.id, changed_imports[id(b[4])])
            elif target[1] == src.mod:
                new = table[target[1:]]
                other, ob = tree.lookup(new, scope)
                if ob is not None and other is not src.top:
                    report.append(f"{src.path}:{node.lineno}: {new} is a local name where {node.id} is used")
                ed.at(node.lineno, node.col_offset, node.id, new)
        for node, scope in src.attrs:
            r = tree.resolve(src, node, scope)
            if r and r[0] == "sym" and r[1:] in table and node.attr == r[2]:
                ed.at(node.end_lineno, node.end_col_offset - len(node.attr.encode()), node.attr, table[r[1:]])
        _strings(tree, src, ed, table)
        _globals(src, ed, mine)
        _embedded_strings(tree, src, ed, table)
        if ed.items:
            (root / src.path).write_text(ed.apply())
    if docs:
        report += _prose(root, table, owners)
        for p in [*root.glob("docs/**/*.md"), root / "README.md", *root.glob("examples/**/*.md")]:
            if "decisions" in p.parts:
                continue
            text = p.read_text()
            new = re.sub(r"```python\n.*?```", lambda m: embedded(tree, m.group(0), table), text, flags=re.S)
            for (m, n), name in table.items():
                if m == "polishd.model.events":
                    new = re.sub(rf"^\| `{n}`, `", f"| `{name}`, `", new, flags=re.M)
            new = errors_renamed(new, table)
            if new != text:
                p.write_text(new)
    return report


EMBEDDED = re.compile(r"from (polishd[\w.]*) import ([\w, ]+)")


def embedded(tree, text, table):
    """Code in a string or a page: what it imports by name gets its new name, and wherever else it has it."""
    for m in EMBEDDED.finditer(text):
        for part in m.group(2).split(","):
            name, _, alias = part.strip().partition(" as ")
            r = tree.real(m.group(1), name) if tree.is_module(m.group(1)) else None
            if r and r[0] == "sym" and r[1:] in table and r[2] == name:
                text = re.sub(rf"(?:(?<![\w'\"])|(?<=\\n)){name}\b", table[r[1:]], text)

    def attribute(m):
        r = tree.real("polishd.researcher", m.group(1))
        return f"polishd.{table[r[1:]]}" if r and r[0] == "sym" and r[1:] in table else m.group(0)

    return re.sub(r"(?<![\w.])polishd\.(\w+)\b(?!\.)", attribute, text)


CAMEL = re.compile(r"[A-Z][a-z]+[A-Z]\w*")


def _embedded_strings(tree, src, ed, table):
    import io
    import tokenize

    outside = src.mod.split(".")[0] == "tests"
    names: dict[str, set] = {}
    for (m, n), new in table.items():
        if CAMEL.fullmatch(n):
            names.setdefault(n, set()).add(new)
    for tok in tokenize.generate_tokens(io.StringIO(src.text).readline):
        if tok.type != tokenize.STRING:
            continue
        row, col = tok.start
        start = ed.pos(row, len(src.lines[row - 1][:col].encode()))
        end = start + len(tok.string.encode())
        if any(start <= s < end for s, _ in ed.items):
            continue
        new = embedded(tree, tok.string, table) if "import" in tok.string else tok.string
        inner = tok.string.strip("\"'")
        if outside and inner in names and len(names[inner]) == 1:
            new = tok.string.replace(inner, next(iter(names[inner])))
        if not tok.string.lstrip("rRbBfF").startswith('"""'):  # what is said; docstrings are for the words' step
            new = errors_renamed(new, table)
        if new != tok.string:
            ed.put(start, end, new)


def errors_renamed(text, table):
    """Classes of errors are said in messages, and written into records."""
    for (m, n), new in table.items():
        if m == "polishd.model.errors":
            text = re.sub(rf"(?<![\w./]){n}\b", new, text)
    return text


def _same(tree, src, scope, new, r):
    return False


def _globals(src, ed, mine):
    for node in ast.walk(src.tree):
        if isinstance(node, ast.Global):
            for n in node.names:
                if n in mine:
                    raw = src.lines[node.lineno - 1]
                    i = re.search(rf"\b{n}\b", raw).start()
                    ed.at(node.lineno, i, n, mine[n])


def _strings(tree, src, ed, table):
    for node, scope in src.calls:
        fn = node.func
        name = fn.attr if isinstance(fn, ast.Attribute) else fn.id if isinstance(fn, ast.Name) else ""
        # setattr(module, "name", ...), getattr(module, "name"), patch.setattr(...)
        if name in SETTERS and len(node.args) >= 2 and isinstance(node.args[1], ast.Constant) and isinstance(node.args[1].value, str):
            r = tree.resolve(src, node.args[0], scope)
            if r and r[0] == "mod":
                sym = tree.real(r[1], node.args[1].value)
                if sym and sym[0] == "sym" and sym[1:] in table and sym[2] == node.args[1].value:
                    c = node.args[1]
                    ed.at(c.lineno, c.col_offset + 1, sym[2], table[sym[1:]])
        if name == "cast" and node.args and isinstance(node.args[0], ast.Constant) and isinstance(node.args[0].value, str):
            _quoted(tree, src, ed, table, node.args[0], scope)
        if name in {"TypeVar", "ParamSpec", "NewType"} and node.args and isinstance(node.args[0], ast.Constant):
            c = node.args[0]
            if (src.mod, c.value) in table:
                ed.at(c.lineno, c.col_offset + 1, c.value, table[src.mod, c.value])
        if name == "TypeVar":
            for k in node.keywords:
                if k.arg == "bound" and isinstance(k.value, ast.Constant) and isinstance(k.value.value, str):
                    _quoted(tree, src, ed, table, k.value, scope)
    for node in ast.walk(src.tree):  # __all__
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets):
            for c in ast.walk(node.value):
                if isinstance(c, ast.Constant) and isinstance(c.value, str):
                    r = tree.real(src.mod, c.value)
                    if r and r[0] == "sym" and r[1:] in table and r[2] == c.value:
                        ed.at(c.lineno, c.col_offset + 1, c.value, table[r[1:]])
    for node, scope in src.strings:  # "polishd.a.b.name"
        v = node.value
        if re.fullmatch(r"(polishd|tests|benchmarks)(\.\w+)+", v) and node.lineno == node.end_lineno:
            m, _, n = v.rpartition(".")
            if tree.is_module(m) and m in tree.files:
                r = tree.real(m, n)
                if r and r[0] == "sym" and r[1:] in table and r[2] == n:
                    ed.at(node.lineno, node.end_col_offset - 1 - len(n), n, table[r[1:]])


def _quoted(tree, src, ed, table, c, scope):
    if c.lineno != c.end_lineno:
        return
    expr = ast.parse(c.value, mode="eval")
    for n in ast.walk(expr):
        r = None
        if isinstance(n, ast.Name):
            r = tree.resolve(src, n, scope)
            if r and r[0] == "sym" and r[1:] in table and r[2] == n.id:
                ed.at(c.lineno, c.col_offset + 1 + n.col_offset, n.id, table[r[1:]])
        elif isinstance(n, ast.Attribute):
            r = tree.resolve(src, n, scope)
            if r and r[0] == "sym" and r[1:] in table and r[2] == n.attr:
                ed.at(c.lineno, c.col_offset + 1 + n.end_col_offset - len(n.attr), n.attr, table[r[1:]])


def _prose(root, table, owners):
    """Names in ``backticks`` of docstrings, comments and docs, where only one thing has that name."""
    sure = {}
    for (m, n), new in table.items():
        if owners.get(n) == {m} and (n[0].isupper() or "_" in n):
            sure[n] = new
    if not sure:
        return []
    rx = re.compile(r"(?<![\w/.-])(?:(?<=`)|(?<=\.))(" + "|".join(map(re.escape, sorted(sure, key=len, reverse=True))) + r")\b(?=[`.(\[,])")
    out = []
    from analysis import SKIP

    for p in [*root.rglob("*.py"), *root.rglob("*.md")]:
        rel = p.relative_to(root)
        if SKIP & set(rel.parts) or rel.name == "CHANGELOG.md" or "decisions" in rel.parts:
            continue
        text = p.read_text()
        new = re.sub(r"`+[^`\n]+`+", lambda q: re.sub(r"(?<![\w/-])(" + "|".join(map(re.escape, sure)) + r")\b(?!\s*=|/)", lambda m: sure[m.group(1)], q.group(0)), text) if p.suffix == ".md" else re.sub(
            r"``[^`\n]+``", lambda q: re.sub(r"(?<![\w/-])(" + "|".join(map(re.escape, sure)) + r")\b(?!\s*=|/)", lambda m: sure[m.group(1)], q.group(0)), text
        )
        if new != text:
            p.write_text(new)
            out.append(f"prose: {rel}")
    return out


def read_table(path: Path) -> dict:
    table = {}
    for line in path.read_text().splitlines():
        line = line.split("#")[0].strip()
        if line:
            old, new = line.split()
            m, _, n = old.rpartition(".")
            table[m, n] = new
    return table


if __name__ == "__main__":
    for line in rename(Path(sys.argv[1]), read_table(Path(sys.argv[2]))):
        print(line)
