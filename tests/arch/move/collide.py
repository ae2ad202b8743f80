"""What must be renamed before files can be merged: collide.py ROOT MAP -> lines 'module.name ? reason'."""
import ast, builtins, sys, collections
from pathlib import Path
from analysis import Tree
KEEP = {'log', '__all__'}
def read_map(path):
    tgt, dele = {}, set()
    for line in Path(path).read_text().splitlines():
        line = line.strip()
        if not line or line[0] == '#': continue
        t, s = line.split(':', 1)
        for x in s.split():
            m = 'polishd' if x == '(pkg)' else 'polishd.' + x
            if t.strip() == '-': dele.add(m)
            else: tgt[m] = t.strip()
    return tgt, dele
def groups(tgt):
    g = collections.defaultdict(list)
    for m, t in tgt.items(): g[t].append(m)
    return g
def same_statement(T, a, b, name):
    def stm(m):
        for st in T.files[m].tree.body:
            if isinstance(st, (ast.Assign, ast.AnnAssign)):
                ts = st.targets if isinstance(st, ast.Assign) else [st.target]
                if any(isinstance(t, ast.Name) and t.id == name for t in ts): return ast.unparse(st)
    return stm(a) is not None and stm(a) == stm(b)
def collisions(T, tgt):
    out = []
    for t, ms in groups(tgt).items():
        ms = [m for m in ms if m in T.files]
        if len(ms) < 2: continue
        inside = set(ms)
        info = {}
        for m in ms:
            src = T.files[m]
            d, imp = {}, {}
            for n, bs in src.top.bindings.items():
                for b in bs:
                    if b[0] == 'import':
                        r = (T.real(b[1], b[2]) if b[2] is not None and T.is_module(b[1]) else None) or ('ext', b[1], b[2], (b[4].asname or '') if b[2] is None else '')
                        if b[2] is None: r = ('ext', b[1], None)
                        imp[n] = r
                    else: d[n] = b
            free = set()
            for node, sc in src.names:
                s, bs = T.lookup(node.id, sc)
                if bs is None: free.add(node.id)
            anyloc = {n for sc in src.scopes if sc is not src.top for n in sc.bindings}
            info[m] = (d, imp, free, anyloc)
        done = set()
        for i, a in enumerate(ms):
            for b in ms:
                if a == b: continue
                da, ia, fa, la = info[a]; db, ib, fb, lb = info[b]
                for n in da:
                    if n in KEEP: continue
                    if n in db and ms.index(b) > i and not same_statement(T, a, b, n):
                        small = min((a, b), key=lambda m: len(T.files[m].lines)); 
                        out.append((small, n, f'defined in {a} and {b}', t))
                    if n in ib and ib[n] not in (('sym', a, n),) :
                        out.append((a, n, f'imported in {b} as {ib[n]}', t))
                    if n in fb and n in dir(builtins):
                        out.append((a, n, f'builtin in {b}', t))
                for n in ia:
                    if n in ib and ia[n] != ib[n] and ms.index(b) > i:
                        ra, rb = ia[n], ib[n]
                        if ra[0] == 'ext' and rb[0] == 'ext' and ra[1].split('.')[0] == rb[1].split('.')[0]: continue
                        if ra[0] == 'mod' and (ra[1] in inside): continue
                        if rb[0] == 'mod' and (rb[1] in inside): continue
                        na = tgt.get(ra[1]) if ra[0] == 'mod' else None; nb = tgt.get(rb[1]) if rb[0] == 'mod' else None
                        if na and na == nb: continue
                        out.append((a, n, f'imports differ: {a} {ra}, {b} {rb}', t))
                # module alias of a file of the same group: alias.X becomes X, which must not be shadowed
                for node, sc in T.files[b].attrs:
                    if isinstance(node.value, ast.Name):
                        r = T.resolve(T.files[b], node.value, sc)
                        if r == ('mod', a):
                            s, bs = T.lookup(node.attr, sc)
                            if bs is not None and not (T.binding_target(T.files[b], s, bs, node.attr)[0] == ('sym', a, node.attr)):
                                out.append((a, node.attr, f'shadowed in {b}:{node.lineno}', t))
                # an imported alias: from a import x as y
    return out
if __name__ == '__main__':
    T = Tree(Path(sys.argv[1])); tgt, dele = read_map(sys.argv[2])
    seen = {}
    for m, n, why, t in collisions(T, tgt):
        seen.setdefault((m, n), (why, t))
    for (m, n), (why, t) in sorted(seen.items(), key=lambda x: x[1][1]): print(f'{m}.{n} ?  # {t}: {why}')
