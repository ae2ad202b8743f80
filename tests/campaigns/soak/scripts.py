"""Scripts of parts: faults with their shares, the end that each should lead to, and the actions of the operator.

The simulator's file is written for the part before its job is added. A strike comes while the part is under way. Where
a person is needed, the cell is held with a reason that the person expects, and goes on once the cause is mended.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from tests.campaigns.soak.cell import SoakCell

Strike = Callable[[SoakCell], None]
When = Literal["", "between jobs", "in contact", "solving"]

ACCEPTED, ASIDE = "accepted", "set aside"
THIS = "THE PART"
"""Placeholder for the part's name in a section of the simulator's file."""


@dataclass(frozen=True, slots=True)
class Visit:
    """Visit of the operator because the cell is held."""

    says: str
    """Regular expression that the reason must match."""
    mends: Strike = SoakCell.quiet


@dataclass(frozen=True, slots=True)
class Script:
    """Fault of a part with its expected end."""

    name: str
    share: float
    """Weight among all scripts."""
    sim: Mapping[str, Mapping[str, Any]]
    """Sections of the simulator's file."""
    when: When = ""
    strike: Strike = SoakCell.quiet
    end: str = ACCEPTED
    faults: tuple[str, ...] = ("",)
    """Fault classes that the queue may report."""
    visits: tuple[Visit, ...] = ()
    """Visits while the job is under way, or when its end stops the queue."""
    after: tuple[Visit, ...] = ()
    """Visits before the next part is loaded."""
    wires: tuple[Mapping[str, Any], ...] = ()
    """``[[fault]]`` tables of the simulator's file."""
    restarts: int = 0
    """Number of restarts of the daemon by the service manager."""

    @property
    def needs_person(self) -> bool:
        """Whether the part is accepted only with an operator."""
        return self.end != ACCEPTED or bool(self.visits or self.after)

    def sections(self, part: str) -> dict[str, dict[str, Any]]:
        """Return the sections of the simulator's file for that part."""
        named = {THIS: [part]}
        return {
            header: {key: named.get(value, value) if isinstance(value, str) else value for key, value in keys.items()}
            for header, keys in self.sim.items()
        }


def late(device: str, jitter_s: float, rate: float, by_s: float) -> tuple[Mapping[str, Any], ...]:
    """Return a fault that delays every frame by up to the jitter, and a share of them by much more."""
    delay = {"device": device, "what": "delay"}
    much = {**delay, "rate": rate, "by_s": by_s}
    return ({**delay, "rate": 1.0, "jitter_s": jitter_s}, much) if jitter_s else (much,)


IN_THE_WAY = "the loader must not move below it"
GATE = Visit("the queue stopped: instrument or alignment is wrong")
TOOL = Visit("the queue stopped: .*(from the next part would differ|removal rate|instrument or alignment is wrong)")
AWAY = Visit(IN_THE_WAY)


def _jammed(bits: str) -> Visit:
    return Visit(bits, SoakCell.reset_loader)


CALM = Script("nothing", 50.0, {})
RECOVERED = (
    Script("robot's frames late", 2.5, {}, wires=late("robot", 0.01, 0.02, 0.15)),
    Script("actuator's answers late", 2.5, {}, wires=late("actuator", 0.004, 0.02, 0.1)),
    # A drive is read and written over SDO, where a frame that is lost ends the link: none is lost or garbled here.
    Script("spindle's frames late", 4.0, {}, wires=late("spindle", 0.004, 0.02, 0.1)),
    Script("loader answers late", 2.0, {}, wires=late("loader", 0.0, 0.5, 0.3)),
    Script("file of zeros first", 2.0, {"interferometer.faults": {"preallocate": True}}),
    Script("old map dropped again", 2.0, {"interferometer.faults": {"duplicate_first": True}}),
    Script("another part's map first", 2.0, {"interferometer.faults": {"wrong_part_first": True}}),
    Script("instrument takes 3 s to write", 2.0, {"interferometer": {"write_s": 3.0}}),
    Script("daemon stopped for 0.3 s", 2.0, {}, "in contact", lambda cell: cell.pause("daemon", 0.3)),
    # A robot without progress for about 0.3 s ends contact: 0.1 s must not, 1 s must.
    Script("robot stopped for 0.1 s", 2.0, {}, "in contact", lambda cell: cell.pause("robot", 0.1)),
    Script("daemon killed between jobs", 2.0, {}, "between jobs", SoakCell.kill_daemon, restarts=1),
)
"""Scripts that polishd completes alone."""
BY_A_PERSON = (
    Script(
        "daemon killed as it computes",
        1.5,
        {},
        "solving",
        SoakCell.kill_daemon,
        visits=(Visit("this job was begun earlier"),),
        restarts=1,
    ),
    Script(
        "daemon killed in contact",
        1.5,
        {},
        "in contact",
        SoakCell.kill_daemon,
        visits=(Visit("was interrupted"),),
        restarts=1,
    ),
    Script("loader jams", 1.5, {"loader.faults": {"jammed": THIS}}, visits=(_jammed("jammed"),)),
    Script("loader drops the part", 1.5, {"loader.faults": {"dropped": THIS}}, visits=(_jammed("dropped"),)),
    Script("loader brings another part", 1.5, {"loader.faults": {"wrong": THIS}}, end=ASIDE, faults=("WrongPart",)),
    Script(
        "... and does not notice",
        1.5,
        {"loader.faults": {"wrong_part_unnoticed": THIS}},
        end=ASIDE,
        faults=("WrongPart",),
    ),
    Script(
        "worker killed as it computes", 1.0, {}, "solving", SoakCell.kill_worker, end=ASIDE, faults=("ComputeError",)
    ),
    Script(
        "actuator's wire cut",
        1.5,
        {},
        "in contact",
        lambda cell: cell.cut("actuator"),
        end=ASIDE,
        faults=("LinkError",),
        after=(AWAY,),
    ),
    Script(
        "robot's link cut",
        1.5,
        {},
        "in contact",
        lambda cell: cell.cut("robot"),
        end=ASIDE,
        faults=("LinkError",),
        after=(AWAY,),
    ),
    Script(
        "robot stopped for 1 s",
        1.5,
        {},
        "in contact",
        lambda cell: cell.pause("robot", 1.0),
        end=ASIDE,
        faults=("SafetyStop",),
        after=(AWAY,),
    ),
    Script(
        "force sticks at 60 %",
        1.5,
        {},
        "in contact",
        lambda cell: cell.press("actuator"),
        end=ASIDE,
        faults=("SafetyStop",),
        after=(Visit(IN_THE_WAY, lambda cell: cell.reboot("actuator")),),
    ),
    Script(
        "spindle's drive fails",
        1.5,
        {},
        "in contact",
        lambda cell: cell.press("spindle"),
        end=ASIDE,
        faults=("DeviceFault", "SafetyStop"),
        after=(Visit(IN_THE_WAY, lambda cell: cell.reboot("spindle")),),
    ),
    Script(
        "tool has lost half of its rate",
        2.0,
        {"hidden_truth": {"tool_wear": 0.5}},
        end=ASIDE,
        faults=("RemovalCheckStop", "ToolStop"),
        visits=(TOOL,),
    ),
    Script(
        "map flipped",
        2.0,
        {"interferometer.faults": {"mirror": True}},
        end=ASIDE,
        faults=("RemovalCheckStop",),
        visits=(GATE,),
    ),
    Script(
        "map turned by 90 deg",
        2.0,
        {"interferometer.faults": {"rotation_deg": 90}},
        end=ASIDE,
        faults=("RemovalCheckStop",),
        visits=(GATE,),
    ),
    Script(
        "map with the wrong sign",
        1.0,
        {"interferometer.faults": {"sign": -1}},
        end=ASIDE,
        faults=("RemovalCheckStop",),
        visits=(GATE,),
    ),
    Script(
        "wavefront for surface",
        1.0,
        {"interferometer.faults": {"factor": 2.0}},
        end=ASIDE,
        faults=("RemovalCheckStop",),
        visits=(GATE,),
    ),
)
"""Scripts that need an operator, or whose part is not accepted."""
SCRIPTS = (CALM, *RECOVERED, *BY_A_PERSON)
LIVED = tuple(one for script in RECOVERED if not script.restarts for one in (CALM, script))
"""Scripts that the daemon survives, used in turn by ``--life``."""
