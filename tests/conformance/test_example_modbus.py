"""examples/plugin_modbus, made of what `polishd.api` exports alone, over both ports' suites."""

import ast
import importlib.util
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import ModuleType

import pluggy

from polishd import api, hookspecs
from polishd.testing.suites.actuator import *
from polishd.testing.suites.actuator import ActuatorRig
from polishd.testing.suites.device import *
from tests.conformance.rigs.actuators import PATIENT, TOUCHES
from tests.conformance.rigs.wired import on_wire
from tests.fakes.actuator import Coil, ModbusCoil
from tests.fakes.wires import PtyWire, TcpWire

SOURCE = Path(__file__).resolve().parents[2] / "examples" / "plugin_modbus" / "polishd_example_modbus.py"


def _plugin() -> ModuleType:
    spec = importlib.util.spec_from_file_location("polishd_example_modbus", SOURCE)
    assert spec
    assert spec.loader
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


PLUGIN = _plugin()


@asynccontextmanager
async def example_modbus_tcp(_: Path) -> AsyncIterator[ActuatorRig]:
    """On Modbus TCP."""
    coil = Coil()
    wire = await TcpWire(ModbusCoil(coil, rtu=False)).start()
    device = PLUGIN.Actuator(api.Tcp("127.0.0.1", wire.port), 1, PATIENT)
    async with on_wire(wire, device, lambda: coil.state == 0, scope=TOUCHES) as rig:
        yield rig


@asynccontextmanager
async def example_modbus_rtu(folder: Path) -> AsyncIterator[ActuatorRig]:
    """On a serial line."""
    coil = Coil()
    wire = PtyWire(ModbusCoil(coil, rtu=True), folder / "rtu")
    device = PLUGIN.Actuator(api.SerialLine(wire.path), 1, PATIENT)
    async with on_wire(wire, device, lambda: coil.state == 0, scope=TOUCHES) as rig:
        yield rig


CASES = [example_modbus_tcp, example_modbus_rtu]


def test_it_answers_the_hook_and_builds_from_options(tmp_path: Path) -> None:
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    manager.register(PLUGIN)
    manager.check_pending()
    ((kind,),) = manager.hook.polishd_device_types()
    options = kind.options.model_validate({"address": "tcp://127.0.0.1:502", "watchdog_ms": 500})
    device = kind.build(options, api.DeviceContext(tmp_path, tmp_path, "P", []))
    assert (kind.name, kind.port, device.times.watchdog_s) == ("example_modbus", "actuator", 0.5)


def test_it_imports_nothing_of_polishd_but_its_api() -> None:
    tree = ast.parse(SOURCE.read_text())
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    assert {name for name in modules if name.startswith("polishd")} == {"polishd.api"}
