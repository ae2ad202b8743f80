"""The simulated voice-coil actuator: behavior and the two protocols."""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import Callable

from polishd.config.simulator_devices import SimActuatorSection
from polishd.model.surface import FloatArray
from polishd.sim_backends.common.device_profile import SimDeviceProfile
from polishd.sim_backends.common.framing import AsciiSlave, CoilRegisters, RtuSlave, TcpSlave
from polishd.sim_backends.common.hidden_truth import stream
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import Message, SimRuntime
from polishd.sim_backends.common.voice_coil import COIL_FAULTS, CoilDynamics, VoiceCoil
from polishd.sim_backends.common.wire import FaultyLink, Feed, SimWire
from polishd.sim_backends.profile_device.device import ForceDrive, Slave, by_profile

# The voice-coil actuator's process.

TICK_S = 0.005
MARK_S = 0.02
TCP = {"modbus_tcp", "profile_tcp"}
VENDOR, MODEL, SERIAL, FIRMWARE = "polishd", "simulated VC50", "SIM-V1", "1.0"


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    config, speed = runtime.start.config.actuator, runtime.start.speed
    coil = VoiceCoil(
        rng=stream(runtime.start.seed, "coil"),
        report=runtime.link.event,
        now_s=time.monotonic(),
        pace=CoilDynamics(config.land_s / speed, config.lift_s / speed, config.stick_share, config.resting_force_n),
        touch_um=runtime.link.welcome.get("touch_um"),
    )

    def on_message(message: Message | FloatArray) -> None:
        if isinstance(message, dict) and "touch_um" in message:
            coil.step(time.monotonic())
            coil.touch_um = message["touch_um"]

    runtime.link.on_message = on_message
    runtime.script.suffer = coil.suffer
    wire = SimWire(runtime, lambda outlet: _feed(runtime, coil, outlet))
    endpoint = f"serial:{runtime.start.state / runtime.name}?baud={config.baud}"
    if config.kind in TCP:
        endpoint = f"tcp://{await wire.open_tcp(config.port)}"
    else:
        wire.open_pty(config.baud)
    runtime.button(signal.SIGUSR1, lambda: setattr(coil, "stuck", True))
    runtime.button(signal.SIGUSR2, lambda: setattr(coil, "hung", True))
    wire.ready(endpoint)
    await _tick(runtime, coil)


def _feed(runtime: SimRuntime, coil: VoiceCoil, outlet: FaultyLink) -> Feed:
    """Receive the requests of one connection. Each answer waits for the time that the request takes on the line."""
    config = runtime.start.config.actuator
    registers = CoilRegisters(coil, VENDOR, MODEL, SERIAL, FIRMWARE, runtime.boot_count)
    makers: dict[str, Callable[[], Slave]] = {
        "modbus_rtu": lambda: RtuSlave(config.unit, registers.answer),
        "modbus_tcp": lambda: TcpSlave(config.unit, registers.answer),
        "serial": lambda: AsciiSlave(coil, f"{VENDOR},{MODEL},{SERIAL},{FIRMWARE},{runtime.boot_count}"),
        "profile": lambda: by_profile(_sheet(runtime), _drive(runtime, coil), config.unit, tcp=False),
        "profile_tcp": lambda: by_profile(_sheet(runtime), _drive(runtime, coil), config.unit, tcp=True),
    }
    slave = makers[config.kind]()
    byte_s = 0.0 if config.kind in TCP else 10.0 / config.baud

    def feed(data: bytes) -> None:
        now = time.monotonic()
        coil.step(now)
        if coil.hung:
            return
        for size, answer in slave.feed(data, now):
            outlet.send(answer, size * byte_s)

    return feed


def _sheet(runtime: SimRuntime) -> SimDeviceProfile:
    """Path of the profile, relative to SIM.toml."""
    config = runtime.start.config
    return SimDeviceProfile.read(config.resolve(config.actuator.profile))


def _drive(runtime: SimRuntime, coil: VoiceCoil) -> ForceDrive:
    orders = _sheet(runtime).raw["commands"]
    identity = {"vendor": VENDOR, "model": MODEL, "serial": SERIAL, "firmware": FIRMWARE}
    identity["boot"] = str(runtime.boot_count)
    return ForceDrive(coil, identity, engages="engage" in orders, beats="heartbeat" in orders)


async def _tick(runtime: SimRuntime, coil: VoiceCoil) -> None:
    marked = 0.0
    while True:
        now = time.monotonic()
        coil.step(now)
        if coil.samples or now - marked >= MARK_S:
            runtime.link.samples(coil.samples, coil.now_s)
            coil.samples = []
            marked = now
        await asyncio.sleep(TICK_S)


SIM_DEVICES = [
    SimDevice(
        name="actuator",
        device="actuator",
        section=SimActuatorSection,
        links={
            "modbus_rtu": {"": "modbus_rtu"},
            "modbus_tcp": {"": "modbus_tcp"},
            "serial": {"": "numbered lines"},
            "profile": {"": "profile"},
            "profile_tcp": {"": "profile_tcp"},
        },
        main=main,
        faults=COIL_FAULTS,
    )
]
