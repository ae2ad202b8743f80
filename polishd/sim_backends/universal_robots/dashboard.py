"""The dashboard server: a line in, a line out. Any number of clients is served at once, as a real one does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from polishd.sim_backends.universal_robots.controls import (
    NORMAL,
    PAUSED,
    PAUSING,
    POWER_OFF,
    PROTECTIVE_STOP,
    RUNNING,
    STOPPED,
)
from polishd.sim_backends.universal_robots.machine import UrController

GREETING = b"Connected: Universal Robots Dashboard Server\n"
_SAFETY = {NORMAL: "NORMAL", PROTECTIVE_STOP: "PROTECTIVE_STOP"}
DASHBOARD_LINE_BYTES = 1000


@dataclass(slots=True)
class Dashboard:
    """One connection. Those that stop or pause are answered when that is done."""

    machine: UrController
    send: Callable[[bytes], None]
    later: Callable[[Callable[[], bool], Callable[[], None]], None]
    """Calls the second once the first is true."""
    _rest: bytes = b""

    def feed(self, data: bytes) -> None:
        """Answer each whole line."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-DASHBOARD_LINE_BYTES:]
        for line in lines:
            self._answer(line.decode("utf-8", "replace").strip())

    def _say(self, text: str) -> None:
        self.send(text.encode() + b"\n")

    def _answer(self, asked: str) -> None:
        machine = self.machine
        if asked == "stop":
            machine.stop()
            self.later(lambda: machine.runtime == STOPPED, lambda: self._say("Stopped"))
        elif asked == "pause":
            paused = machine.pause()
            if paused:
                self.later(lambda: machine.runtime != PAUSING, lambda: self._say("Pausing program"))
            else:
                self._say("Failed to execute: pause")
        else:
            self._say(self._order(asked) or self._state(asked) or f"could not understand: '{asked}'")

    def _order(self, asked: str) -> str:
        machine = self.machine
        if asked == "play":
            return "Starting program" if machine.play() else "Failed to execute: play"
        if asked == "power off":
            machine.power_off()
            return "Powering off"
        if asked in {"power on", "brake release"}:
            machine.robot_mode = RUNNING if machine.safety_mode == NORMAL else POWER_OFF
            return "Powering on" if asked == "power on" else "Brake releasing"
        if asked == "unlock protective stop":
            machine.unlock()
            return "Protective stop releasing"
        verb, _, rest = asked.partition(" ")
        said = {"popup": "showing popup", "close": "closing popup", "addToLog": "Added log message"}
        return f"File not found: {rest}" if verb == "load" else said.get(verb, "")

    def _state(self, asked: str) -> str:
        machine = self.machine
        modes = {RUNNING: "RUNNING", POWER_OFF: "POWER_OFF"}
        program = "STOPPED" if machine.program is None else "PAUSED" if machine.runtime == PAUSED else "PLAYING"
        known = {
            "running": f"Program running: {str(machine.runtime != STOPPED).lower()}",
            "robotmode": f"Robotmode: {modes.get(machine.robot_mode, 'IDLE')}",
            "safetymode": f"Safetymode: {_SAFETY.get(machine.safety_mode, 'ROBOT_EMERGENCY_STOP')}",
            "safetystatus": f"Safetystatus: {_SAFETY.get(machine.safety_mode, 'ROBOT_EMERGENCY_STOP')}",
            "programState": f"{program} polishd",
            "get loaded program": "No program loaded",
            "isProgramSaved": "true",
            "is in remote control": str(machine.remote).lower(),
            "PolyscopeVersion": "URSoftware 5.11.0.0 (simulated)",
            "version": "URSoftware 5.11.0.0 (simulated)",
            "get robot model": "UR5",
            "get serial number": "SIM-UR1",
            "quit": "Disconnected",
        }
        return known.get(asked, "")
