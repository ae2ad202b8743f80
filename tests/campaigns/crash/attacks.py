"""The kinds of attacks of the campaign of kills, and a cell that suffers a dozen of them."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.campaigns.crash.kills import Attack, Campaign, Count, attacked_cell
from tests.campaigns.site import Site
from tests.time_limits import SOON_S

ATTACKS = 12
"""Of one cell, and then it goes on to the end of its job."""
ROBOT_STANDS_S = 4.0
"""Longest where the robot was killed or stopped: silence, force off, and the watchdog of the actuator behind them."""
STOPS_S, STOPS_SHARE = (0.1, 0.3, 1.0, 2.0, 5.0, 20.0, 60.0), (3, 3, 3, 3, 2, 1, 2)


def at_commit(cell: Campaign) -> None:
    """The daemon, at one of its commits."""
    cell.site.start(("-m", "tests.campaigns.crash.killed_daemon", str(cell.commit()), cell.where()))
    cell.begin()
    cell.until_ended(SOON_S)
    cell.strike()


def at_random(cell: Campaign) -> None:
    """The daemon, at any moment."""
    cell.site.start()
    end_s = time.monotonic() + cell.luck.uniform(0.0, 8.0)
    cell.begin()
    cell.until_ended(end_s - time.monotonic())
    cell.strike()


def in_contact(cell: Campaign) -> None:
    """The daemon, with the tool on the part."""
    cell.site.start()
    cell.begin()
    cell.until_contact()
    cell.strike()


def landing(cell: Campaign) -> None:
    """The daemon, while the tool is on its way to the part."""
    cell.site.start()
    cell.begin()
    cell.until("engage")
    time.sleep(cell.luck.uniform(0.0, 0.3))
    cell.strike()


def leaving(cell: Campaign) -> None:
    """The daemon, while it takes the tool off: it was ordered to hold, and is killed before, amid or after the lift."""
    cell.site.start()
    cell.begin()
    cell.until_contact()
    told = threading.Thread(target=cell.site.order, args=("hold",))  # answers when all is safe, or never
    told.start()
    time.sleep(cell.luck.uniform(0.0, 0.5))
    cell.strike()
    cell.site.kill()
    told.join()


def worker(cell: Campaign) -> None:
    """The compute worker: the daemon ends over it, or has another one."""
    cell.site.start()
    cell.begin()
    time.sleep(cell.luck.uniform(0.0, 2.5))
    cell.strike()
    for pid in cell.site.workers():
        os.kill(pid, signal.SIGKILL)
    cell.until_ended()


def rebooted(device: str) -> Callable[[Campaign], None]:
    """A device loses its power in contact, and boots."""

    def do(cell: Campaign) -> None:
        cell.site.start()
        cell.begin()
        cell.until_contact()
        cell.strike()
        cell.site.reboot(device)
        cell.until_ended()

    return do


def stopped(who: str) -> Callable[[Campaign], None]:
    """A process stands still for a while."""

    def do(cell: Campaign) -> None:
        cell.site.start()
        cell.begin()
        cell.until_contact()
        cell.strike()
        pids = _pids(cell.site, who)
        seconds = cell.luck.choices(STOPS_S, STOPS_SHARE)[0]
        for number, then_s in ((signal.SIGSTOP, seconds), (signal.SIGCONT, 0.0)):
            for pid in filter(None, pids):
                os.kill(pid, number)
            time.sleep(then_s)
        cell.until_ended()

    return do


def _pids(site: Site, who: str) -> list[int]:
    """Of the process that is to stand still."""
    if who == "worker":
        return site.workers()
    return [site.pid if who == "daemon" else site.device(who)]


def disk(calls: str, fault: str) -> Callable[[Campaign], None]:
    """The n-th of these system calls, and all of them from then on, do what a broken disk does."""

    def do(cell: Campaign) -> None:
        inject = f"inject={calls}:{fault}:when={cell.luck.randrange(1, 30)}+"
        tracer = ("strace", "-f", "-qq", "--seccomp-bpf", "-o", "/dev/null", "-e", f"trace={calls}", "-e", inject)
        cell.site.start(tracer=tracer)
        cell.begin()
        cell.until_ended(6.0)

    return do


SYNCS, WRITES, ANY_WRITES = "fsync,fdatasync", "pwrite64", "pwrite64,write,writev"
ATTACKS_KNOWN = (
    Attack("daemon at a commit", at_commit, 10),
    Attack("daemon at random", at_random, 4),
    Attack("daemon in contact", in_contact, 4),
    Attack("daemon landing", landing, 1),
    Attack("daemon leaving", leaving, 2),
    Attack("worker", worker, 2),
    Attack("robot", rebooted("robot"), 1, stands_s=ROBOT_STANDS_S),
    Attack("actuator", rebooted("actuator"), 1),
    Attack("spindle", rebooted("spindle"), 1),
    Attack("interferometer", rebooted("interferometer"), 1),
    Attack("SIGSTOP daemon", stopped("daemon"), 1, kills=False),
    Attack("SIGSTOP robot", stopped("robot"), 1, kills=False, stands_s=ROBOT_STANDS_S),
    Attack("SIGSTOP actuator", stopped("actuator"), 1, kills=False),
    Attack("SIGSTOP spindle", stopped("spindle"), 1, kills=False),
    Attack("SIGSTOP worker", stopped("worker"), 1, kills=False),
    Attack("ENOSPC in any file and on serial lines", disk(ANY_WRITES, "error=ENOSPC"), 1, kills=False),
    Attack("ENOSPC", disk(WRITES, "error=ENOSPC"), 1, kills=False),
    Attack("EIO of a write", disk(WRITES, "error=EIO"), 1, kills=False),
    Attack("EIO of an fsync", disk(SYNCS, "error=EIO"), 1, kills=False),
    Attack("slow fsync", disk(SYNCS, "delay_exit=400000"), 1, kills=False),
)


def drawn(luck: random.Random, number: int) -> Iterator[Attack]:
    """So many attacks, each kind by its share."""
    yield from luck.choices(ATTACKS_KNOWN, [attack.share for attack in ATTACKS_KNOWN], k=number)


def part(folder: Path, seed: int, number: int, attacks: int = ATTACKS) -> Count:
    """One cell: so many attacks, drawn by seed and number, and on to the end of its job."""
    count, luck = Count(), random.Random(f"{seed} {number}")
    with attacked_cell(folder, seed + number) as site:
        campaign = Campaign(site, luck, count, number * attacks)
        try:
            for attack in drawn(luck, attacks):
                campaign.attack(attack)
            campaign.finish()
        except (AssertionError, subprocess.TimeoutExpired) as error:
            count.wrong("stuck", f"part {number}, after {attack.name}: {error}")
    return count
