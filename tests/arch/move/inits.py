"""One sentence for each folder of the source, in its __init__.py: inits.py ROOT. Names what belongs there."""

import ast
import sys
from pathlib import Path

ROOT = Path(sys.argv[1]) / "polishd"
SENTENCES = {
    "cli": "The command line: options and printing, one file a command group; it decides nothing.",
    "maps": "`polishd map`: show, compare, convert, average and stitch interferometer maps, test absolutely, commission.",
    "programs": "`polishd program` and `polishd plan`: make, rewrite, verify and plan a part program without a cell.",
    "commissioning": "What makes a cell ready: its first files, calibration, rehearsal against simulators, device profiles.",
    "commissioning/init": "`polishd init`: questions, answers and the files of a new cell.",
    "commissioning/calibration": "`polishd calibrate`: fits of robot, tool and instrument from measurements.",
    "commissioning/rehearsal": "The simulated copy of a cell: its draft, its devices, its part and its processes.",
    "studies": "Studies: simulations, sweeps and closed loops against simulated plants, described by a file.",
    "reports": "Reports: of a run, of a map, and the certificate of a part.",
    "reports/certificate": "The certificate of a part: its content, PDF and JSON, and the signature over both.",
    "rendering": "How results look: the document model with its HTML and PDF writers, plot style, terminal tables.",
    "web": "The page and the HTTP API of a cell: a process apart, a client of the daemon's socket.",
    "web/http": "The HTTP server of page and shop: connections, users, sessions, limits, TLS certificates.",
    "opcua": "The cell as an OPC UA machine for the systems of a plant: a process apart, a client of the daemon's socket.",
    "shop": "A shop of several cells: its parts, recipes, queue and history in one database, and each cell's link to it.",
    "daemon": "The controller of a cell: cycle, state machine, job runner, assembly and checks.",
    "daemon/job": "One job of the daemon: its records, part handling, tools, map wait and estimates.",
    "daemon/queue": "The queue of jobs and the requests that change it.",
    "daemon/contact": "The tool in contact: streaming, force and time checks, interruption, the safe way out.",
    "daemon/cell": "The devices of the daemon's cell: polling, readiness, time limits, recording.",
    "daemon/journal": "The journal on disk: records, schema, array store, checksums, history.",
    "daemon/notifications": "Notifications of the daemon: which event is sent, to whom, and the sender.",
    "daemon/socket": "The daemon's socket: its server, its client and the commands of both.",
    "daemon/runtime": "What all of the daemon runs on: process, log, events, exit record, compute worker.",
    "plugins": "Hook implementations of this project, declared in the entry-point group that other plugins use.",
    "plugins/rnc_robot": "Part programs of robots: dialects, reading, rewriting and verification.",
    "plugins/rnc_robot/gcode": 'G-code text (`kind = "nc"`): one scanner over all bytes, and a rewriter number by number.',
    "plugins/interferometer/formats": "Map formats, one file each; each ends in its ``SurfaceReader``.",
    "pipeline": "The computing steps of a cycle: condition, learn, solve, plan; recipe, records, acceptance, decisions.",
    "drivers": "Drivers: one file or folder a device protocol. A driver imports no other driver but ``drivers.transport``.",
    "drivers/transport": "What drivers share: addresses, lines, CAN, Modbus, streams, and the tracking of a running program.",
    "drivers/robot_link": "The robot link: the project's protocol to a robot controller, docs/protocols/robot_link.md.",
    "config": "Configuration models, one file a kind of file: cell, job, instrument, device, controller, simulator, study.",
    "process": "Pure functions on arrays: robot, removal, dwell, metrology, toolpath, identification.",
    "process/robot": "Robot models: kinematics, compliance along a path, motion, calibration.",
    "process/removal": "Material removal: contact, tool influence functions, convolution and effect of a dwell map.",
    "process/dwell": "The dwell-time problem: its statement, solvers, bounds and certificates.",
    "process/metrology": "Maps: conditioning, registration, resampling, Zernike, spectra, statistics, tolerances, uncertainty.",
    "process/toolpath": "Tool paths, their spacing, and the apertures that they cover.",
    "process/identification": "Identification: compare what was removed with what was planned, and name and fit the cause.",
    "process/fft": "Compiled Fourier transforms for the dwell solvers.",
    "model": "Nouns that all layers share: surface, program, events, errors, devices, estimates, outline, tolerance, states.",
    "util": "Files, threads, compiled functions, secrets, wire recording: what knows nothing of polishing.",
    "sim_backends/common": "What simulated devices share: runtime, wires, framing, faults, mechanics.",
    "testing/suites": None,
}
for folder in sorted({p.parent for p in ROOT.rglob("*.py")}):
    name = folder.relative_to(ROOT).as_posix()
    path = folder / "__init__.py"
    if name == ".":
        continue
    text = path.read_text() if path.exists() else ""
    body = ast.parse(text).body
    sentence = SENTENCES.get(name)
    if sentence is None:
        if not ast.get_docstring(ast.parse(text)):
            print("no sentence for", name)
        continue
    assert len(sentence) <= 114, (name, len(sentence))
    if len(body) <= 1 and (not body or ast.get_docstring(ast.parse(text))):
        path.write_text(f'"""{sentence}"""\n')
    else:
        print("has more than a sentence:", name)
