"""renames.csv -> a table of symbols; prints what it cannot read."""
import csv, re, sys
from pathlib import Path
from analysis import Tree
T = Tree(Path(sys.argv[1])); out = open(sys.argv[2], 'w'); un = []
seen = {}
for row in csv.DictReader(open(Path(__file__).with_name('renames.csv'))):
    k, cur, new, why = row['kind'], row['current'], row['new'], row['why']
    if k not in ('class', 'error class', 'event', 'function'): continue
    olds = [x.strip() for x in cur.split(',')]; news = [x.strip() for x in new.split(',')]
    if len(olds) != len(news): un.append((k, cur, new)); continue
    mod = None
    for o, n in zip(olds, news):
        if not re.fullmatch(r'\w+', n): un.append((k, o, n)); continue
        if '.' in o: mod, _, o = o.rpartition('.')
        full = None
        cands = [mod] if mod else []
        m = 'polishd.' + mod if mod else None
        if k in ('event',) and m is None: m = 'polishd.model.events'
        if k == 'error class' and m is None: m = 'polishd.model.errors'
        if m and m in T.files and o in T.files[m].top.bindings and any(b[0] != 'import' for b in T.files[m].top.bindings[o]):
            full = m
        else:
            c = [s.mod for s in T.files.values() if s.mod.startswith('polishd') and o in s.top.bindings and any(b[0]!='import' for b in s.top.bindings[o])]
            if mod: 
                c2=[x for x in c if x.startswith(m)]
                c = c2 or c
            if len(c) == 1: full = c[0]
        if full is None: un.append((k, f'{mod}.{o}', n)); continue
        if o == n: continue
        out.write(f'{full}.{o} {n}\n'); seen.setdefault(n, []).append(f'{full}.{o}')
print(len(seen)); 
for u in un: print('UNREAD', u)
for n, v in seen.items():
    if len(v) > 1: print('TWICE', n, v)
