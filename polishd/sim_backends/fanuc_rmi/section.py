"""Keys of ``[robot]`` in SIM.toml with ``kind = "fanuc_rmi"``."""

from __future__ import annotations

from typing import Literal

from polishd.config.simulator_devices import Port, SimRobotSection


class SimFanucRmiSection(SimRobotSection):
    """FANUC controller: ``[robot]`` with ``kind = "fanuc_rmi"``."""

    kind: Literal["fanuc_rmi"]  # type: ignore[assignment]
    session_port: Port = 0
    """TCP port on loopback of the session, which FRC_Connect returns; 0: `port` + 1. [1]"""
