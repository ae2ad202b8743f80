"""Move and merge modules: merge.py ROOT MAP. Works in place, with git mv for the largest source of each new file."""

from __future__ import annotations

import ast
import collections
import io
import json
import re
import subprocess
import sys
import tokenize
from pathlib import Path

from analysis import SKIP, Edits, Tree
from collide import groups, read_map

DOTTED = re.compile(r"(?<![\w./-])polishd(\.\w+)+")
EMBEDDED = re.compile(r"from (polishd[\w.]*) import ([\w, ]+\w)")
FUTURE = "from __future__ import annotations"


def newmod(t):
    parts = ("polishd/" + t)[:-3].split("/")
    if parts[-1] == "__init__":
        parts.pop()
    return ".".join(parts)


class Move:
    def __init__(self, root: Path, mapfile: str, extra: dict[str, str]):
        self.root = root
        self.T = Tree(root)
        tgt, self.dele = read_map(mapfile)
        self.tgt = {m: t for m, t in tgt.items() if m in self.T.files}
        self.missing = [m for m in self.T.files if m.split(".")[0] == "polishd" and m not in tgt and m not in self.dele]
        self.NEW = {m: newmod(t) for m, t in self.tgt.items()}
        for m in self.missing:
            self.NEW[m] = m
        self.PKG = extra  # packages whose name changes, for strings
        self.report = []
        self.groups = {t: self.topo(ms) for t, ms in groups(self.tgt).items()}

    def topo(self, ms):
        ms = list(ms)
        dep = collections.defaultdict(set)
        for m in ms:
            src = self.T.files[m]
            for stmt, scope in src.imports:
                if scope.kind != "module" or stmt not in src.tree.body:
                    continue
                for r in self.targets(src, stmt):
                    if r and r[1] in ms and r[1] != m:
                        dep[m].add(r[1])
        out, done = [], set()

        def visit(m):
            if m in done:
                return
            done.add(m)
            for r in ms:
                if r in dep[m]:
                    visit(r)
            out.append(m)

        for m in ms:
            visit(m)
        return out

    def targets(self, src, stmt):
        if isinstance(stmt, ast.Import):
            return [("mod", a.name) if self.T.is_module(a.name) else None for a in stmt.names]
        base = stmt.module or ""
        if not self.T.is_module(base):
            return [None] * len(stmt.names)
        return [self.T.real(base, a.name) for a in stmt.names]

    # ---- names of modules within one new file
    def locals_for(self, sources):
        """{id(alias): local name} for imports of modules, decided over all sources of a file."""
        here = {self.NEW.get(s.mod) for s in sources}
        taken = collections.defaultdict(set)  # name -> what it means
        for s in sources:
            for sc in s.scopes:
                if sc.kind == "class":
                    continue
                for n, bs in sc.bindings.items():
                    for b in bs:
                        if b[0] == "import":
                            r = ("mod", b[1]) if b[2] is None else (self.T.real(b[1], b[2]) if self.T.is_module(b[1]) else None)
                            if r and r[0] == "mod" and r[1] in self.NEW:
                                taken[n].add(("mod", self.NEW[r[1]]))
                                continue
                        taken[n].add((s.mod, n))
            for node, sc in s.names:
                if self.T.lookup(node.id, sc)[1] is None:
                    taken[node.id].add("free")
        names, chosen = {}, {}
        for s in sources:
            for stmt, scope in s.imports:
                for a, r in zip(stmt.names, self.targets(s, stmt), strict=True):
                    if not r or r[0] != "mod" or r[1] not in self.NEW:
                        continue
                    if isinstance(stmt, ast.Import) and not a.asname:
                        continue
                    new = self.NEW[r[1]]
                    if len(sources) and new in here and s.mod in self.NEW and self.NEW[s.mod] == new:
                        continue
                    old = a.asname or a.name
                    leaf = new.rpartition(".")[2]
                    if new in chosen:
                        names[id(a)] = chosen[new]
                        continue
                    if a.asname and a.asname != a.name and a.asname != r[1].rpartition(".")[2]:
                        local = old  # an alias that the author chose
                    elif taken[leaf] <= {("mod", new)}:
                        local = leaf
                    elif taken[old] <= {("mod", new)}:
                        local = old
                    else:
                        local = f"{new.split('.')[-2]}_{leaf}"
                        self.report.append(f"{s.path}: {old} becomes {local}")
                    taken[local].add(("mod", new))
                    chosen[new] = local
                    names[id(a)] = local
        return names

    def facade(self, src, a):
        """{attribute: (module, name, local name)} of what is taken from a package that goes, by its alias."""
        if not hasattr(src, "facades"):
            src.facades = {}
        if id(a) in src.facades:
            return src.facades[id(a)]
        found = {}
        for node, scope in src.attrs:
            if not isinstance(node.value, ast.Name):
                continue
            s, bs = self.T.lookup(node.value.id, scope)
            b = next((x for x in bs or () if x[0] == "import"), None)
            if b is None or b[4] is not a:
                continue
            r = self.T.resolve(src, node, scope)
            if r and r[0] == "mod" and r[1] in self.NEW:
                leaf = self.NEW[r[1]].rpartition(".")[2]
                used = {n for sc in src.scopes if sc.kind != "class" for n in sc.bindings} | {n.id for n, _ in src.names}
                local = leaf if leaf not in used else f"{a.asname or a.name}_{leaf}"
                found[node.attr] = (r[1], None, local)
                continue
            if r is None or r[0] != "sym":
                self.report.append(f"{src.path}:{node.lineno}: {ast.unparse(node)} of a package that goes")
                continue
            used = {n for sc in src.scopes for n in sc.bindings} | {n.id for n, _ in src.names}
            local = r[2] if r[2] not in used or found.get(node.attr, ("", "", ""))[2] == r[2] else f"{a.asname or a.name}_{r[2]}"
            found[node.attr] = (r[1], r[2], local)
        src.facades[id(a)] = found
        return found

    def goes(self, r):
        return r and r[0] == "mod" and r[1] in self.dele and r[1] not in self.NEW

    def statements(self, src, stmt, names, here):
        """New import lines for a statement; what is of the same new file is left out."""
        res = []
        for a, r in zip(stmt.names, self.targets(src, stmt), strict=True):
            if self.goes(r) and isinstance(stmt, ast.ImportFrom):
                for m, n, local in self.facade(src, a).values():
                    if n is None:
                        pk, _, leaf = self.NEW[m].rpartition(".")
                        res.append(f"from {pk} import {leaf}" + (f" as {local}" if local != leaf else ""))
                    elif self.NEW[m] != here:
                        res.append(f"from {self.NEW[m]} import {n}" + (f" as {local}" if local != n else ""))
        for a, r in zip(stmt.names, self.targets(src, stmt), strict=True):
            if self.goes(r) and isinstance(stmt, ast.ImportFrom):
                continue
            if isinstance(stmt, ast.Import):
                if a.name.split(".")[0] == "polishd" and a.name in self.NEW:
                    new = self.NEW[a.name]
                    res.append(f"import {new}" + (f" as {names.get(id(a), a.asname)}" if a.asname else ""))
                else:
                    res.append(f"import {a.name}" + (f" as {a.asname}" if a.asname else ""))
                continue
            base = stmt.module or ""
            if base == "__future__":
                continue
            if r is None or r[1].split(".")[0] != "polishd" or (r[0] == "mod" and r[1] not in self.NEW):
                if a.name == "*" and base in self.NEW:
                    res.append(f"from {self.NEW[base]} import *")
                else:
                    res.append(f"from {base} import {a.name}" + (f" as {a.asname}" if a.asname else ""))
                continue
            if r[0] == "mod":
                new = self.NEW[r[1]]
                if new == here:
                    continue
                pk, _, leaf = new.rpartition(".")
                local = names[id(a)]
                res.append(f"from {pk} import {leaf}" + (f" as {local}" if local != leaf else ""))
                continue
            m, name = r[1], r[2]
            # by the module that it is imported from, unless that goes
            if base in self.NEW and base not in self.dele and not (
                base == "polishd.api" and (here or "").startswith(("polishd.drivers.transport", "polishd.process"))
            ):
                m, name = base, a.name
            new = self.NEW.get(m, m)
            local = a.asname or a.name
            if new == here or self.NEW.get(r[1]) == here:
                continue
            if a.asname and a.asname == a.name:
                res.append(f"from {new} import {name} as {name}")
            else:
                res.append(f"from {new} import {name}" + (f" as {local}" if local != name else ""))
        return res

    def edits(self, src, names, here, ed, *, imports_in_place):
        T = self.T
        selfmods, goers, selfnames = set(), set(), {}
        for stmt, scope in src.imports:
            top = stmt in src.tree.body
            for a, r in zip(stmt.names, self.targets(src, stmt), strict=True):
                if self.goes(r):
                    goers.add(id(a))
                if r and r[0] == "sym" and self.NEW.get(r[1]) == here and here is not None and a.asname and a.asname != r[2]:
                    selfnames[id(a)] = r[2]
                if r and r[0] == "mod" and self.NEW.get(r[1]) == here and here is not None and src.mod in self.NEW:
                    selfmods.add(id(a))
            if top and not imports_in_place:
                continue
            if not self.touched(src, stmt):
                continue
            lines = self.statements(src, stmt, names, here)
            start = ed.pos(stmt.lineno, stmt.col_offset)
            end = ed.pos(stmt.end_lineno, stmt.end_col_offset)
            ind = " " * stmt.col_offset
            if not lines:  # the line goes, with what stands behind it
                raw = ed.data
                start = ed.pos(stmt.lineno, 0)
                end = raw.index(b"\n", end) + 1
                ed.put(start, end, "")
            else:
                ed.put(start, end, f"\n{ind}".join(lines))
        for node, scope in src.attrs:
            if isinstance(node.value, ast.Name):
                s, bs = T.lookup(node.value.id, scope)
                if bs is None:
                    continue
                b = next((x for x in bs if x[0] == "import"), None)
                if b is not None and id(b[4]) in goers:
                    found = self.facade(src, b[4]).get(node.attr)
                    if found:
                        local = found[1] if found[1] and self.NEW[found[0]] == here else found[2]
                        ed.put(ed.pos(node.lineno, node.col_offset), ed.pos(node.end_lineno, node.end_col_offset), local)
                if b is not None and id(b[4]) in selfmods:
                    ed.put(ed.pos(node.lineno, node.col_offset), ed.pos(node.end_lineno, node.end_col_offset), node.attr)
            # import polishd.a.b; polishd.a.b.c
        selfattr = {id(n.value) for n, _ in src.attrs if isinstance(n.value, ast.Name)}
        for node, scope in src.names:
            s, bs = T.lookup(node.id, scope)
            if bs is None:
                continue
            b = next((x for x in bs if x[0] == "import"), None)
            if b is None:
                continue
            own = selfnames.get(id(b[4]))
            if own is not None and own != node.id:
                ed.at(node.lineno, node.col_offset, node.id, own)
                continue
            if id(b[4]) in selfmods:
                if id(node) not in selfattr:
                    self.report.append(f"BARE MODULE {src.path}:{node.lineno}: {node.id}")
                continue
            local = names.get(id(b[4]))
            if local is not None and local != node.id:
                ed.at(node.lineno, node.col_offset, node.id, local)
        for tok in tokenize.generate_tokens(io.StringIO(src.text).readline):
            if tok.type != tokenize.STRING or "polishd." not in tok.string:
                continue
            row, col = tok.start
            at = ed.pos(row, len(src.lines[row - 1][:col].encode()))
            spans = []
            for m in EMBEDDED.finditer(tok.string):  # from polishd.package import module
                new = self.embedded(m)
                if new is not None:
                    start = at + len(tok.string[: m.start()].encode())
                    ed.put(start, start + len(m.group(0).encode()), new)
                    spans.append(m.span())
            for m in DOTTED.finditer(tok.string):
                if any(a <= m.start() < b for a, b in spans):
                    continue
                new = self.dotted(m.group(0))
                if new != m.group(0):
                    start = at + len(tok.string[: m.start()].encode())
                    ed.put(start, start + len(m.group(0).encode()), new)

    def embedded(self, m):
        found = [part.strip().partition(" as ") for part in m.group(2).split(",")]
        lines = []
        for name, _, alias in found:
            new = self.NEW.get(f"{m.group(1)}.{name}")
            if new is None:
                return None
            pk, _, leaf = new.rpartition(".")
            lines.append(f"from {pk} import {leaf}" + (f" as {alias or name}" if leaf != (alias or name) else ""))
        return "; ".join(lines)

    def touched(self, src, stmt):
        if isinstance(stmt, ast.Import):
            return any(a.name in self.NEW for a in stmt.names)
        return (stmt.module or "").split(".")[0] == "polishd"

    def dotted(self, text):
        parts = text.split(".")
        for n in range(len(parts), 0, -1):
            head = ".".join(parts[:n])
            for table in (self.NEW, self.PKG):
                if head in table and head != "polishd":
                    return ".".join([table[head], *parts[n:]])
        return text

    # ---- a merged file
    def build(self, t):
        ms = self.groups[t]
        here = newmod(t)
        sources = [self.T.files[m] for m in ms]
        names = self.locals_for(sources)
        imports: dict[str, str] = {}
        guarded: dict[str, str] = {}
        bodies, mains, docs = [], [], {}
        for src in sources:
            ed = Edits(src)
            d = ast.get_docstring(src.tree, clean=False)
            d = d and DOTTED.sub(lambda m: self.dotted(m.group(0)), d)
            docs[src.mod] = d
            drop = []
            if d is not None:
                drop.append((src.tree.body[0].lineno, src.tree.body[0].end_lineno))
            for stmt in src.tree.body:
                if isinstance(stmt, (ast.Import, ast.ImportFrom)):
                    drop.append((stmt.lineno, stmt.end_lineno))
                    raw = "".join(src.lines[stmt.lineno - 1 : stmt.end_lineno])
                    note = re.search(r"#.*", raw)
                    for line in self.statements(src, stmt, names, here):
                        imports.setdefault(line, "")
                        if note and len(stmt.names) >= 1:
                            imports[line] = "  " + note.group(0)
                elif isinstance(stmt, ast.If) and ast.unparse(stmt.test) in {"TYPE_CHECKING", "typing.TYPE_CHECKING"} and not stmt.orelse:
                    if all(isinstance(x, (ast.Import, ast.ImportFrom)) for x in stmt.body):
                        drop.append((stmt.lineno, stmt.end_lineno))
                        for x in stmt.body:
                            for line in self.statements(src, x, names, here):
                                guarded[line] = ""
            self.edits(src, names, here, ed, imports_in_place=False)
            dropped = {i for a, b in drop for i in range(a, b + 1)}
            for a, b in drop:  # nothing else may be edited there
                for s, e in [k for k in ed.items if ed.pos(a, 0) <= k[0] < ed.pos(b + 1, 0)]:
                    del ed.items[s, e]
                ed.put(ed.pos(a, 0), ed.pos(b + 1, 0) if b < len(src.lines) else len(ed.data), "")
            body = ed.apply()
            k = body.find('\nif __name__ == "__main__":')
            if k >= 0:
                mains.append(body[k:].strip("\n"))
                body = body[: k + 1]
            bodies.append((src, body.strip("\n")))
        direct = {}  # of one thing that is imported from two places, the place where it is
        for line in list(imports):
            mm = re.fullmatch(r"from (\S+) import (\w+)(?: as (\w+))?", line)
            if mm:
                direct.setdefault(mm.group(3) or mm.group(2), []).append(line)
        for lines in direct.values():
            if len(lines) > 1:
                for line in lines:
                    if line.startswith("from polishd.api "):
                        del imports[line]
        first = self.leading(t)
        out = []
        if docs.get(first):
            out.append('"""' + docs[first] + '"""\n')
        if imports or guarded or any(b for _, b in bodies):
            out.append(FUTURE + "\n")
        top = [line + note for line, note in imports.items()]
        if top:
            out.append("\n".join(top) + "\n")
        extra = [line for line in guarded if line not in imports]
        if extra:
            if "from typing import TYPE_CHECKING" not in imports:
                out.insert(-1, "from typing import TYPE_CHECKING\n")
            out.append("if TYPE_CHECKING:\n" + "\n".join("    " + line for line in extra) + "\n")
        said = set()  # assignments of one line that two sources have: the logger, type variables
        for src, body in bodies:
            kept = []
            for line in body.splitlines(keepends=True):
                if re.match(r"[A-Za-z_]\w* = (logging\.getLogger|TypeVar|ParamSpec)\(.*\)$", line.rstrip()):
                    if line.rstrip() in said:
                        continue
                    said.add(line.rstrip())
                kept.append(line)
            body = "".join(kept)
            if not body.strip():
                continue
            if src.mod != first and docs.get(src.mod) and len(bodies) > 1:
                text = " ".join(docs[src.mod].split("\n\n")[0].split())
                out.append("\n# " + text if len(text) < 110 else "\n" + wrap(text))
            out.append("\n" + body + "\n")
        for m in mains[:1]:
            out.append("\n\n" + m + "\n")
        if len(mains) > 1:
            self.report.append(f"{t}: {len(mains)} mains")
        return "\n".join(out)

    def leading(self, t):
        ms = [m for m in self.tgt if self.tgt[m] == t]
        return ms[0]

    def run(self):
        texts = {t: self.build(t) for t in self.groups}
        outside = {}
        for src in self.T.files.values():
            if src.mod in self.tgt or src.mod in self.dele:
                continue
            names = self.locals_for([src])
            ed = Edits(src)
            self.edits(src, names, None, ed, imports_in_place=True)
            if ed.items:
                outside[src.path] = ed.apply()
        for path, text in outside.items():
            (self.root / path).write_text(text)
        gone = []
        for t, ms in self.groups.items():
            target = Path("polishd") / t
            paths = [self.T.files[m].path for m in ms]
            if str(target) not in paths:
                big = max(ms, key=lambda m: len(self.T.files[m].lines))
                (self.root / target).parent.mkdir(parents=True, exist_ok=True)
                gone.append((self.T.files[big].path, target))
        self.apply_moves(gone, texts)
        return self.report

    def apply_moves(self, gone, texts):
        git = lambda *a: subprocess.run(["git", "-C", str(self.root), *a], check=True, capture_output=True)
        # through temporary names: a target may be another one's source
        for i, (old, new) in enumerate(gone):
            git("mv", old, f"polishd/_moving_{i}.py")
        moved = {old for old, _ in gone}
        for t, ms in self.groups.items():
            for m in ms:
                p = self.T.files[m].path
                if p not in moved and p != str(Path("polishd") / t):
                    git("rm", "-q", p)
        for m in self.dele:
            if m in self.T.files and self.T.files[m].path not in {str(Path("polishd") / t) for t in self.groups}:
                git("rm", "-q", "-f", self.T.files[m].path)
        for i, (old, new) in enumerate(gone):
            (self.root / new).parent.mkdir(parents=True, exist_ok=True)
            git("mv", f"polishd/_moving_{i}.py", str(new))
        for t, text in texts.items():
            p = self.root / "polishd" / t
            p.parent.mkdir(parents=True, exist_ok=True)
            p.write_text(text)
        for d in {p.parent for p in (self.root / "polishd").rglob("*.py") if "__pycache__" not in p.parts}:
            q = d
            while q != self.root and not (q / "__init__.py").exists():
                (q / "__init__.py").write_text("")
                q = q.parent


def wrap(text):
    import textwrap

    return "\n".join("# " + line for line in textwrap.wrap(text, 116))


if __name__ == "__main__":
    extra = json.loads(Path(__file__).with_name("packages.json").read_text())
    mv = Move(Path(sys.argv[1]), sys.argv[2], extra)
    print("not in the map:", mv.missing)
    for line in mv.run():
        print(line)
    out = Path(sys.argv[3])
    (out / "new.json").write_text(json.dumps(mv.NEW, indent=0))
    paths = {mv.T.files[m].path: "polishd/" + t for m, t in mv.tgt.items()}
    (out / "paths.json").write_text(json.dumps(paths, indent=0))
