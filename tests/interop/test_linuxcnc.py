"""LinuxCNC's own Modbus masters at our simulated devices: mb2hal, which fits any, and the driver of GS2 inverters."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from polishd.config.device_profile_checks import DEVICE_PROFILE_DIR
from polishd.drivers.transport.address import SerialLine, Tcp
from tests.interop import devices as d
from tests.interop.hal import hal
from tests.interop.peers import Peer
from tests.system.sim_rig import Cell, cell, wait_for

PEER = Peer("LinuxCNC", "Modbus RTU and TCP", "master (mb2hal, gs2_vfd)", "Debian", "linuxcnc-uspace")
pytestmark = PEER.needed

INIT = "[MB2HAL_INIT]\nVERSION=1.1\nHAL_MODULE_NAME=mb2hal\nSLOWDOWN=0.0\nTOTAL_TRANSACTIONS={count}\n"
TRANSACTION = """
[TRANSACTION_{at:02}]
{where}
MB_SLAVE_ID=1
MB_TX_CODE=fnct_{function}
FIRST_ELEMENT={first}
NELEMENTS={count}
HAL_TX_NAME={name}
MAX_UPDATE_RATE=50.0
MB_RESPONSE_TIMEOUT_MS=5000
MB_BYTE_TIMEOUT_MS=1000
"""
COIL = (
    ("says", "04_read_input_registers", 0, 6),
    ("asked", "16_write_multiple_registers", 1, 2),
    ("heartbeat", "06_write_single_register", 3, 1),
    ("command", "06_write_single_register", 0, 1),
)
PLC = (
    ("says", "04_read_input_registers", 0, 6),
    ("stands", "01_read_coils", 0, 4),
    ("sees", "02_read_discrete_inputs", 0, 2),
    ("orders", "15_write_multiple_coils", 0, 4),
    ("heartbeat", "06_write_single_register", 0, 1),
)
GS2_HAS = (*range(0x2104, 0x210D), 0x091D, 0x0100, 0x0101, 0x0102, 0x0605)
"""Registers that gs2_vfd reads or writes, and no driver of ours."""
STOPPED = "[01][06][09][1B][00][00]"
SPINDLE = """
[spindle]
kind = "profile"
profile = "gs2.toml"
watchdog_s = 60.0
"""


def mb2hal(cell: Cell, device: str, table: tuple[tuple[str, str, int, int], ...], ini: Path) -> str:
    """What loads it, with those transactions."""
    address = d.wire(cell, device)
    if isinstance(address, Tcp):
        where = f"LINK_TYPE=tcp\nTCP_IP={address.host}\nTCP_PORT={address.port}"
    else:
        # of a longer path it takes the beginning only
        where = f"LINK_TYPE=serial\nSERIAL_PORT={address.path.resolve()}\nSERIAL_BAUD={address.baud}\n"
        where += "SERIAL_BITS=8\nSERIAL_PARITY=none\nSERIAL_STOP=1\nSERIAL_DELAY_MS=5"
    parts = [INIT.format(count=len(table))]
    parts += [
        TRANSACTION.format(at=at, where=where, name=name, function=function, first=first, count=count)
        for at, (name, function, first, count) in enumerate(table)
    ]
    ini.write_text("".join(parts))
    return f"loadusr -W mb2hal config={ini}"


def works_the_voice_coil(running: Cell, ini: Path) -> None:
    """Pressed with 12 N and lifted, by its pins."""
    with hal() as run:
        run.say(mb2hal(running, "actuator", COIL, ini))
        run.set("mb2hal.asked.01.int", 5000)
        run.set("mb2hal.asked.00.int", 1200)
        run.set("mb2hal.heartbeat.00.int", 41)
        run.set("mb2hal.command.00.int", 1)

        def pressed() -> bool:
            state, force, set_point, _, fault, beat = (run.get(f"mb2hal.says.{at:02}.int") for at in range(6))
            return (state, set_point, fault, beat) == (d.CONTACT, 1200, 0, 41) and abs(force - 1200) < 120

        wait_for(pressed, "12 N")
        run.set("mb2hal.command.00.int", 0)
        wait_for(lambda: run.get("mb2hal.says.00.int") == d.RETRACTED, "retracted")
        assert run.get("mb2hal.says.num_errors") == 0.0


def test_mb2hal_works_our_voice_coil_over_tcp(devices: Cell, tmp_path: Path) -> None:
    works_the_voice_coil(devices, tmp_path / "coil.ini")


def test_mb2hal_works_our_voice_coil_on_a_serial_line(tmp_path: Path) -> None:
    """Use a separate line: a master may end between a request and its answer, which the next master would get."""
    with cell(tmp_path, d.PRESSING + d.RTU) as running:
        works_the_voice_coil(running, tmp_path / "coil.ini")


def test_mb2hal_works_our_plc(devices: Cell, tmp_path: Path) -> None:
    (devices.state / "programs" / "polishd.nc").write_text("\n".join(d.QUICK) + "\n")
    with hal() as run:
        run.say(mb2hal(devices, "robot", PLC, tmp_path / "plc.ini"))
        for order, state in ((d.RESET, d.IDLE), (d.LOAD, d.READY), (d.START, d.DONE)):
            run.set(f"mb2hal.orders.{order:02}.bit", 1)
            wait_for(lambda order=order: run.get(f"mb2hal.stands.{order:02}.bit") == 1, "the order to stand")
            wait_for(lambda state=state: run.get("mb2hal.says.00.int") == state, f"state {state}")
        # asked for after the state, in the same round of the master
        wait_for(lambda: run.get("mb2hal.sees.01.bit") == 0.0, "standstill")
        assert {run.get(f"mb2hal.{name}.num_errors") for name, *_ in PLC} == {0.0}


@pytest.fixture
def inverter(tmp_path: Path) -> Iterator[Cell]:
    """A GS2 as the shipped profile has it, with the registers that LinuxCNC's driver looks at beside."""
    more = "".join(f"\n[registers.at_{address:04x}]\naddress = 0x{address:04X}\n" for address in GS2_HAS)
    (tmp_path / "gs2.toml").write_text((DEVICE_PROFILE_DIR / "automationdirect_gs2.toml").read_text() + more)
    with cell(tmp_path, d.PRESSING + SPINDLE, "--only", "spindle") as found:
        yield found


def test_gs2_vfd_turns_our_inverter_either_way(inverter: Cell) -> None:
    address = d.wire(inverter, "spindle")
    assert isinstance(address, SerialLine)
    with hal() as run:
        run.say(f"loadusr -Wn vfd gs2_vfd -g -n vfd -d {address.path} -r {address.baud} -p none -s 1")
        run.set("vfd.nameplate-RPM", 1800)
        run.set("vfd.nameplate-HZ", 60)
        run.set("vfd.spindle-fwd", 0)
        # before its first word of that it takes the spindle for running
        wait_for(lambda: run.say("") is not None and STOPPED in run.sent, "its first order to stop")
        run.set("vfd.speed-command", 900)
        for way in ("fwd", "rev"):
            run.set(f"vfd.spindle-{way}", 1)
            run.set("vfd.spindle-on", 1)
            wait_for(lambda: run.get("vfd.frequency-out") == 30.0 and run.get("vfd.at-speed"), "30 Hz")
            run.set("vfd.spindle-on", 0)
            run.set(f"vfd.spindle-{way}", 0)
            wait_for(lambda: run.get("vfd.frequency-out") == 0.0 and run.get("vfd.is-stopped"), "standstill")
    turned = {round(entry["rpm"]) for entry in inverter.log() if entry["event"] == "spindle_at_speed"}
    assert turned == {1800, -1800}
