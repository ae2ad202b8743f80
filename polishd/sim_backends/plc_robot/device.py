"""The process of the PLC: its cycle, its server, and reports to the plant."""

from __future__ import annotations

import asyncio
import signal
import time
from pathlib import Path

from polishd.config.simulator import MOTION, SimRobotSection
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import SimRuntime
from polishd.sim_backends.common.wire import SimTcpConnection, SimWire
from polishd.sim_backends.plc_robot import servers
from polishd.sim_backends.plc_robot.controller import Plc
from polishd.sim_backends.plc_robot.servers import ModbusServer, Relay
from polishd.sim_backends.robot.motion import SimRobotBody

CYCLE_S = 0.01
PROGRAMS = "programs"


class PlcServer:
    """All state of the process."""

    def __init__(self, runtime: SimRuntime, folder: Path) -> None:
        machine = SimRobotBody(runtime)
        robot = runtime.start.config.robot
        self.plc = Plc(robot, machine.motion, folder, machine.reach, machine.event, runtime.boot_id)
        machine.blocks_of = self.plc.blocks_of
        self._machine = machine
        self.plc.tick(time.monotonic())

    async def run(self) -> None:
        """Cycle until cancelled."""
        while True:
            now = time.monotonic()
            self._machine.set_pace(now)
            self.plc.tick(now)
            self._machine.report()
            await asyncio.sleep(CYCLE_S)

    def press(self, button: str) -> None:
        """Do an operator's action at the controller."""
        self.plc.press(button, time.monotonic())


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    folder = runtime.start.state / PROGRAMS
    folder.mkdir(exist_ok=True)
    server = PlcServer(runtime, folder)
    runtime.button(signal.SIGUSR1, lambda: server.press("emergency stop"))
    runtime.button(signal.SIGUSR2, lambda: server.press("feed hold"))
    over = {"opcua": _over_opcua, "ads": _over_ads, "modbus": _over_modbus}
    await over[runtime.start.config.robot.kind](runtime, server)


async def _over_opcua(runtime: SimRuntime, server: PlcServer) -> None:
    from polishd.sim_backends.plc_robot.servers import served

    robot = runtime.start.config.robot
    async with served(server.plc) as port:
        wire = SimWire(runtime, Relay(runtime, port).connected)
        wire.ready(f"opc.tcp://{await wire.open_tcp(robot.port)}")
        await server.run()


async def _over_modbus(runtime: SimRuntime, server: PlcServer) -> None:
    robot = runtime.start.config.robot
    wire = SimWire(runtime, ModbusServer(server.plc).connected)
    wire.ready(f"tcp://{await wire.open_tcp(robot.port)}")
    await server.run()


async def _over_ads(runtime: SimRuntime, server: PlcServer) -> None:
    """ADS has one fixed TCP port: the configured port selects a loopback address instead."""
    robot = runtime.start.config.robot
    wire = SimWire(runtime, servers.AdsServer(server.plc).connected)
    high, low = divmod(robot.port, 256)
    host = f"127.{high}.{low}.1"
    loop = asyncio.get_running_loop()
    await loop.create_server(lambda: SimTcpConnection(wire), host, servers.TCP_PORT)
    wire.ready(f"ads://{host}/{host}.1.1:{servers.AMS_PORT}")
    await server.run()


SIM_DEVICES = [
    SimDevice(
        name="plc_robot",
        device="robot",
        section=SimRobotSection,
        links={"opcua": {"": "opcua"}, "ads": {"": "ads"}, "modbus": {"": "modbus_tcp"}},
        main=main,
        faults=MOTION,
    )
]
