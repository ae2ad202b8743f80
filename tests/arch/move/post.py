"""What the move cannot see: data files, files found beside a module, tables of names."""
import re, shutil, subprocess, sys, json
from pathlib import Path
R=Path(sys.argv[1])
def git(*a): subprocess.run(['git','-C',str(R),*a],check=True,capture_output=True)
MOVES=[('workbench/devices/templates','commissioning/templates'),('drivers/profiled/profiles','drivers/profile_device/profiles'),('console/demo_data','commissioning/rehearsal/demo_data'),('plant/nodesets','opcua/nodesets'),('show/sheet.html.jinja','rendering/document.html.jinja'),('show/report.css','rendering/report.css'),('plugins/run_report/report.html.jinja','reports/report.html.jinja')]
for a,b in MOVES:
    (R/'polishd'/b).parent.mkdir(parents=True,exist_ok=True)
    if (R/'polishd'/a).exists(): git('mv','polishd/'+a,'polishd/'+b)
    else: print('no',a)
for line in subprocess.run(['git','-C',str(R),'ls-files','-s'],check=True,capture_output=True,text=True).stdout.splitlines():
    if line.startswith('120000'):  # a link to what has moved
        link=R/line.split('\t')[1]; to=str(link.readlink()); new=to
        for a,b in MOVES: new=new.replace('polishd/'+a,'polishd/'+b)
        if new!=to: link.unlink(); link.symlink_to(new)
def fix(t,*subs):
    p=R/t; x=p.read_text()
    for o,n in subs:
        if o not in x: print('NOT FOUND',t,o)
        x=x.replace(o,n)
    p.write_text(x)
fix('polishd/sim_backends/common/runtime.py',('parents[2]','parents[3]'))
fix('polishd/sim_backends/linuxcnc/machine.py',('{mount}/gate.py','{mount}/hal_gate.py'),('("gate.py", "pendant.py")','("hal_gate.py", "pendant.py")'))
p = R / "polishd/api.py"
x = p.read_text()
rows = {}
for m in re.finditer(r"from polishd\.drivers\.(transport\.\w+) import ([^\n(]+|\([^)]*\))", x):
    rows.setdefault(m.group(1), []).extend(re.findall(r"\w+", m.group(2)))
API = "_TRANSPORT = {\n" + "".join(f'    "{k}": ({", ".join(chr(34) + n + chr(34) for n in v)},),\n' for k, v in rows.items()) + "}\n"
x = re.sub(r"_TRANSPORT = \{.*?\n\}\n", lambda _: API, x, flags=re.S)
p.write_text(x)
fix('polishd/commissioning/rehearsal/part.py',('"polishd.cli"','"polishd.commissioning.rehearsal"'))
fix('polishd/commissioning/rehearsal/simulated_cell.py',('"polishd.cli"','"polishd.commissioning.rehearsal"'))
fix('polishd/plugins/rnc_robot/gcode/jit.py',('for module in (scanner, kernels, scanner, scanner, kernels):','for module in (scanner, kernels):'))
fix('polishd/sim_backends/__main__.py',('"opcua": "handover", "ads": "handover", "modbus": "handover"','"opcua": "plc_robot", "ads": "plc_robot", "modbus": "plc_robot"'),('.server", "main"),','.device", "main"),'),('("spindle.device", "main")','("spindle", "main")'),('("actuator.device", "main")','("actuator", "main")'),('(f"{name}.device", "main")','(name, "main")'))
fix('polishd/sim_backends/monitor.py',('import signal\n','import signal as signals\n')) if False else None
left=[p for p in R.glob('polishd/**/*') if p.is_file() and p.suffix not in ('.py','.pyc')]
print('data:',sorted({str(p.parent.relative_to(R)) for p in left}))
OUT=Path(sys.argv[2]); N=json.loads((OUT/'new.json').read_text()); P=json.loads((OUT/'paths.json').read_text()); PK=json.loads(Path(__file__).with_name('packages.json').read_text())
# every text that names a module or a file
dot={**PK,**N}
dots=re.compile(r'(?<![\w./])('+'|'.join(re.escape(k) for k in sorted((k for k in dot if k!='polishd'),key=len,reverse=True))+r')(?![\w/])')
paths=re.compile(r'(?<![\w.-])('+'|'.join(re.escape(k) for k in sorted(P,key=len,reverse=True))+r')(?!\w)')
short={k[8:]:v[8:] for k,v in dot.items() if k.count('.')>=2}
shorts=re.compile(r'``('+'|'.join(re.escape(k) for k in sorted(short,key=len,reverse=True))+r')((?:\.\w+)*(?:\(\))?)``')
FOLD={'polishd/console/rehearsal/':'polishd/commissioning/rehearsal/','polishd/workbench/devices/':'polishd/commissioning/','polishd/drivers/profiled/':'polishd/drivers/profile_device/','polishd/sim_backends/profiled/':'polishd/sim_backends/profile_device/','polishd/plant/':'polishd/opcua/','polishd/show/':'polishd/rendering/','polishd/recipe/':'polishd/pipeline/','polishd/hooks/':'polishd/plugin_loader.py','polishd/door/':'polishd/web/http/','polishd/ports/':'polishd/interfaces.py','polishd/console/':'polishd/cli/','polishd/sim_backends/mechanics/':'polishd/sim_backends/common/mechanics.py','polishd/process/metrics/':'polishd/process/metrology/','polishd/process/edge/':'polishd/process/removal/'}
def swap(text,py):
    if not py: text=dots.sub(lambda m: dot[m.group(1)],text)
    text=paths.sub(lambda m: P[m.group(1)],text)
    for a,b in FOLD.items(): text=re.sub(r'(?<![\w])'+re.escape(a)+r'(?![a-z_]+\.py)',b,text)
    if py: text=shorts.sub(lambda m: '``'+short[m.group(1)]+m.group(2)+'``',text)
    return text
skip={'.venv','build','.git','node_modules'}
for p in R.rglob('*'):
    rel=p.relative_to(R)
    if not p.is_file() or skip&set(rel.parts) or rel.name in('CHANGELOG.md','requirements.lock') or 'decisions' in rel.parts: continue
    if p.suffix in ('.py',) or p.suffix in ('.md','.toml','.jsonl','.html','.jinja') or rel.name in ('Makefile','run'):
        if rel.name=='pyproject.toml' and len(rel.parts)==1: continue
        x=p.read_text(); y=swap(x,p.suffix=='.py')
        if x!=y: p.write_text(y)
p=R/'pyproject.toml'; x=p.read_text()
a=x.index('[tool.importlinter]'); head=x[:a]
head=dots.sub(lambda m: dot[m.group(1)],head)
head=head.replace('"polishd/plugins/rnc_robot/nc/{words,block,moves,scan,write}.py"','"polishd/plugins/rnc_robot/gcode/{scanner,kernels}.py"').replace('"PLR0917", "PLR1714", "RUF046"','"PLR0917", "PLR1714", "RUF046", "SIM109"').replace('"polishd/process/{transforms/*,dwell/compiled_*,spreading/compiled}.py"','"polishd/process/{fft/*,dwell/{douglas_rachford_iteration,alternating_step},removal/spread_effect_compiled}.py"').replace('"polishd/process/transforms/{lanes,butterflies}.py"','"polishd/process/fft/{simd,transforms}.py"')
p.write_text(head+Path(__file__).with_name('contracts.toml').read_text())
