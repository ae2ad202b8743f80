"""A worker of studies that does what a case's point says: ``python odd_child.py``; nothing is imported."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path


def main() -> None:
    """Answer, fail, hang, or die; "once" in what it is told: at the first try only."""
    print(json.dumps({"ready": json.loads(sys.argv[1])}), flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        case, what = request["case"], str(request["case"]["at"].get("what", ""))
        if what.startswith("once"):
            tried = Path(request["study"]).with_name(f"tried-{case['number']}")
            what = "" if tried.exists() else what.removeprefix("once ")
            tried.touch()
        if what == "dies":
            sys.stderr.write("out of luck\n")
            sys.stderr.flush()
            os.kill(os.getpid(), signal.SIGKILL)
        if what == "hangs":
            signal.pause()
        told = {"rows": [{"rms_nm": case["number"] / 3}], "wall_s": 0.01, "cpu_s": 0.01}
        if what == "refuses":
            told = {"refused": "files differ"}
        if what == "raises":
            told = {"failed": "ValueError: no", "wall_s": 0.01, "cpu_s": 0.01}
        print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main()
