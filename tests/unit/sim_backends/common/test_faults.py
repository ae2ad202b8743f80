"""Scripted faults, pacing, the pseudo-terminal and the config."""

from __future__ import annotations

import asyncio
import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.config.simulator import SimConfig, load_simulator
from polishd.config.simulator_faults import FaultSection
from polishd.model.errors import ConfigError
from polishd.sim_backends.common import framing, runtime
from polishd.sim_backends.common.faults import PROTOCOLS, FaultScript, FrameAction, LinkDirection, protocols
from polishd.sim_backends.common.framing import line, rtu
from polishd.sim_backends.common.runtime import read_config
from polishd.sim_backends.common.wire import FaultyLink, PtyPort
from tests.time_limits import SOON_S

FORGED = ("wrong_unit", "exception")
HOST = LinkDirection("", "numbered lines", "to_host")
DEVICE = LinkDirection("", "numbered lines", "to_device")


class Bench:
    """The script of an actuator, and its events."""

    def __init__(self, *faults: dict[str, Any], device: str = "actuator") -> None:
        self.reported: list[tuple[str, Any]] = []
        self.script = FaultScript(device, 1, self.log_event)
        made = [FaultSection.model_validate({"device": device, **fault}) for fault in faults]
        self.script.set(made, now_s=0.0)

    def log_event(self, event: str, **data: Any) -> None:
        self.reported.append((event, data["what"]))

    def at(self, now_s: float, frame: bytes = b"abcd", way: LinkDirection = HOST) -> FrameAction:
        """What becomes of a frame."""
        return self.script.treat(frame, way, now_s)


def test_without_faults_frames_pass() -> None:
    assert Bench().at(0.0) == FrameAction(b"abcd")


def test_rates_are_kept_and_each_fault_is_logged() -> None:
    bench = Bench(
        {"what": "drop", "rate": 0.2}, {"what": "garble", "rate": 0.1}, {"what": "delay", "rate": 0.3, "by_s": 1.0}
    )
    fates = [bench.at(0.0) for _ in range(4000)]
    assert sum(not fate.data for fate in fates) == pytest.approx(800, rel=0.15)
    assert sum(fate.data not in {b"", b"abcd"} for fate in fates) == pytest.approx(320, rel=0.2)
    assert sum(fate.delay_s == 1.0 for fate in fates) == pytest.approx(1200, rel=0.15)
    assert bench.reported.count(("fault_acts", "drop")) == sum(not fate.data for fate in fates)


def test_damage_is_one_bit() -> None:
    bench = Bench({"what": "garble", "rate": 1.0})
    for _ in range(100):
        assert sum(byte.bit_count() for byte in bench.at(0.0, bytes(8)).data) == 1


def test_the_same_seed_gives_the_same_mischief_whatever_else_is_scripted() -> None:
    faults = [{"what": "drop", "rate": 0.3}, {"what": "garble", "rate": 0.3}]
    one, two = Bench(*faults), Bench(*faults, {"what": "delay", "rate": 1.0, "jitter_s": 0.1})
    assert [one.at(0.0, b"xyz").data for _ in range(50)] == [two.at(0.0, b"xyz").data for _ in range(50)]


def test_a_frame_is_struck_at_a_time_or_by_its_number_once() -> None:
    at_s = Bench({"what": "drop", "at_s": 3.0})
    assert [bool(at_s.at(now_s).data) for now_s in (1.0, 2.9, 3.1, 3.2)] == [True, True, False, True]
    assert at_s.reported == [("fault_acts", "drop")]
    third = Bench({"what": "duplicate", "frame": 3})
    assert third.at(0.0, way=DEVICE).copies == 1, "of the other direction"
    assert [third.at(0.0).copies for _ in range(5)] == [1, 1, 2, 1, 1]


def test_the_operator_acts_once_at_the_panel() -> None:
    bench, pressed = Bench({"what": "estop", "at_s": 1.0}, device="robot"), []
    bench.script.panel["estop"] = lambda: pressed.append("estop")
    for now_s in (0.5, 1.5, 2.5):
        bench.script.look(now_s)
    assert pressed == ["estop"]
    assert bench.reported == [("fault_begins", "estop")]


def test_a_fault_goes_on_for_its_time_and_comes_again() -> None:
    bench = Bench({"what": "drop", "every_s": 5.0, "duration_s": 1.0})
    lost = [now_s for now_s in range(18) if not bench.at(float(now_s)).data]
    assert lost == [5, 11, 17]
    assert bench.reported[:2] == [("fault_begins", "drop"), ("fault_ends", "drop")]
    shared = Bench({"what": "drop", "rate": 1.0, "at_s": 2.0, "duration_s": 1.0})
    assert [bool(shared.at(now_s).data) for now_s in (1.0, 2.5, 3.5)] == [True, False, True]


def test_frames_to_the_device_suffer_where_it_says_so() -> None:
    bench = Bench({"what": "drop", "rate": 1.0, "direction": "to_device"})
    assert (bench.at(0.0).data, bench.at(0.0, way=DEVICE).data) == (b"abcd", b"")


def test_one_that_hangs_neither_hears_nor_speaks() -> None:
    bench = Bench({"what": "hang", "at_s": 1.0, "duration_s": 2.0})
    lost = [[not bench.at(now_s, way=way).data for way in (HOST, DEVICE)] for now_s in (0.5, 1.5, 3.5)]
    assert lost == [[False, False], [True, True], [False, False]]
    assert [event for event, _ in bench.reported] == ["fault_begins", "fault_ends"]


def test_faults_add_up() -> None:
    bench = Bench(
        {"what": "delay", "rate": 1.0, "by_s": 0.1},
        {"what": "delay", "rate": 1.0, "by_s": 0.2},
        {"what": "duplicate", "rate": 1.0},
        {"what": "dribble", "rate": 1.0, "by_s": 0.01},
        {"what": "late_reply", "rate": 1.0, "by_s": 0.7},
    )
    assert bench.at(0.0) == FrameAction(b"abcd", delay_s=pytest.approx(0.3), late_s=0.7, copies=2, byte_s=0.01)


def test_only_one_link_of_several_suffers() -> None:
    bench = Bench({"what": "hang", "link": "rtde", "at_s": 0.0}, device="robot")
    links = ("rtde", "dashboard")
    assert [bench.at(1.0, way=LinkDirection(link, link, "to_host")).data for link in links] == [b"", b"abcd"]


def test_time_in_contact_is_counted_while_the_tool_presses(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench({"what": "stick", "contact_s": 2.0, "duration_s": 1.0})
    suffered: list[bool] = []
    bench.script.suffer = lambda _fault, on: suffered.append(on)
    for now_s, acting_n in ((10.0, 12.0), (11.5, 0.0), (20.0, 12.0)):
        monkeypatch.setattr(time, "monotonic", lambda now_s=now_s: now_s)
        bench.script.feel(acting_n)
    bench.script.look(20.4)
    assert suffered == []
    bench.script.look(20.6)
    bench.script.look(21.0)
    assert suffered == [True]
    bench.script.look(21.7)
    assert suffered == [True, False]


def test_a_reboot_is_not_repeated_by_the_device_that_was_rebooted() -> None:
    reboots: list[bool] = []
    for rebooted in (False, True):
        bench = Bench()
        bench.script.reboot = lambda rebooted=rebooted: reboots.append(rebooted)
        bench.script.set([FaultSection(device="actuator", what="reboot", at_s=1.0)], 0.0, rebooted=rebooted)
        bench.script.look(1.5)
        bench.script.look(2.5)
    assert reboots == [False]


def test_a_file_that_was_read_again_ends_what_acted() -> None:
    bench = Bench({"what": "stick", "at_s": 0.0})
    bench.script.look(0.1)
    bench.script.set([], 0.2)
    bench.script.look(0.3)
    assert [event for event, _ in bench.reported] == ["fault_begins", "fault_ends"]


ACK = framing.pack_json(framing.ACK, {"of": framing.RESUME, "status": {}})
RTU = rtu(1, bytes([3, 2, 0, 7]))
REPLIES: dict[str, list[tuple[bytes, bytes]]] = {
    "modbus_rtu wrong_unit": [(RTU, rtu(2, bytes([3, 2, 0, 7])))],
    "modbus_rtu exception": [(RTU, rtu(1, bytes([0x83, 4])))],
    "modbus_tcp wrong_unit": [(bytes.fromhex("00090000000501 03020007"), bytes.fromhex("00090000000502 03020007"))],
    "modbus_tcp exception": [(bytes.fromhex("00090000000501 03020007"), bytes.fromhex("00090000000301 8304"))],
    "numbered lines exception": [(line("7,OK"), line("7,ERR,fault,a fault is set"))],
    "slcan wrong_unit": [(b"t18521122\r", b"t18621122\r"), (b"z\r", b"")],
    "slcan exception": [(b"t58584300200005000000\r", b"t58588000200000000606\r"), (b"t18521122\r", b"")],
    "socketcand wrong_unit": [(b"< frame 185 0.0 1122 >", b"< frame 186 0.0 1122 >"), (b"< ok >", b"")],
    "socketcand exception": [(b"< frame 585 0.0 4300200005000000 >", b"< frame 585 0.0 8000200000000606 >")],
    "kvp exception": [(bytes.fromhex("00300009000003313030000101"), bytes.fromhex("00300009000003313030000000"))],
    "robot_link exception": [(framing.pack(framing.STATUS, b"{}"), b"")],
    "ads exception": [(bytes(38), bytes(30) + b"\x08\x07\x00\x00" + bytes(4)), (bytes(20), b"")],
}


def test_every_forgery_is_tried() -> None:
    known = {f"{name} {what}" for name, found in PROTOCOLS.items() for what in FORGED if getattr(found, what)}
    assert known == set(REPLIES)


@pytest.mark.parametrize("case", REPLIES)
def test_a_forged_reply_is_sound_in_its_protocol(case: str) -> None:
    protocol, _, what = case.rpartition(" ")
    for reply, forged in REPLIES[case]:
        bench = Bench({"what": what, "frame": 1})
        assert bench.at(0.0, reply, LinkDirection("", protocol, "to_host")).data == (forged or reply)
        assert bench.reported == ([("fault_acts", what)] if forged else []), "it waits for one that it can be made of"


def test_an_executed_command_is_reported_as_refused() -> None:
    forged = PROTOCOLS["robot_link"].exception(ACK)  # type: ignore[misc]
    ((kind, payload),) = framing.Splitter().feed(forged)
    assert (kind, json.loads(payload)["of"]) == (framing.NAK, framing.RESUME)


CUTS: dict[str, list[bytes]] = {
    "robot_link": [ACK, framing.pack(framing.PING)],
    "modbus_tcp": [bytes.fromhex("0009000000050103020007"), bytes.fromhex("000a00000003018304")],
    "numbered lines": [line("7,OK"), line("8,ST?")],
    "slcan": [b"z\r", b"t18521122\r", b"\a"],
    "socketcand": [b"< ok >", b"< frame 185 0.0 1122 >"],
    "rtde": [b"\x00\x05V\x00\x02", b"\x00\x03S"],
    "ads": [b"\0\0\x02\0\0\0ab", b"\0\0\x01\0\0\0c"],
    "opcua": [b"MSGF\x0a\0\0\0xy", b"CLOF\x09\0\0\0z"],
}


@pytest.mark.parametrize("protocol", CUTS)
def test_frames_are_cut_wherever_the_stream_is(protocol: str) -> None:
    found, rest = [], b""
    for byte in b"".join(CUTS[protocol]):
        rest += bytes([byte])
        if size := PROTOCOLS[protocol].cut(rest):
            found.append(rest[:size])
            rest = rest[size:]
    assert found == CUTS[protocol]


async def paced(outlet: FaultyLink, frames: list[bytes], written: list[bytes], expected: int) -> float:
    """Seconds until all has been written."""
    begin = time.monotonic()
    async with asyncio.timeout(SOON_S), asyncio.TaskGroup() as group:
        worker = group.create_task(outlet.run())
        for frame in frames:
            outlet.send(frame)
        while len(b"".join(written)) < expected:  # noqa: ASYNC110  (what is waited for knows no event)
            await asyncio.sleep(0.001)
        worker.cancel()
    return time.monotonic() - begin


async def test_bytes_take_the_time_of_the_line_and_stay_in_order() -> None:
    written: list[bytes] = []
    outlet = FaultyLink(written.append, Bench().script, HOST, byte_s=10.0 / 9600)
    took = await paced(outlet, [b"a" * 50, b"b" * 50], written, 100)
    assert b"".join(written) == b"a" * 50 + b"b" * 50
    assert took >= 100 * 10.0 / 9600 * 0.98


async def test_late_frames_do_not_overtake() -> None:
    written: list[bytes] = []
    late = Bench({"what": "delay", "rate": 1.0, "jitter_s": 0.01})
    sent = [b"%d\n" % k for k in range(20)]
    await paced(FaultyLink(written.append, late.script, HOST), sent, written, len(b"".join(sent)))
    assert b"".join(written) == b"".join(sent)


async def test_a_late_reply_is_passed_by_those_behind_it() -> None:
    written: list[bytes] = []
    late = Bench({"what": "late_reply", "frame": 1, "by_s": 0.05})
    await paced(FaultyLink(written.append, late.script, HOST), [b"a\n", b"b\n", b"c\n"], written, 6)
    assert written == [b"b\n", b"c\n", b"a\n"]


async def test_a_frame_that_dribbles_comes_byte_by_byte() -> None:
    written: list[bytes] = []
    slow = Bench({"what": "dribble", "frame": 1, "by_s": 0.001})
    took_s = await paced(FaultyLink(written.append, slow.script, HOST), [b"abc\n", b"def\n"], written, 8)
    assert written == [b"a", b"b", b"c", b"\n", b"def\n"]
    assert took_s >= 0.004 * 0.98


async def test_a_terminal_behind_a_stable_name(tmp_path: Path) -> None:
    received = asyncio.Queue()
    port = PtyPort(tmp_path / "line", received.put_nowait)
    port.open()
    try:
        host = os.open(tmp_path / "line", os.O_RDWR | os.O_NOCTTY)
        os.write(host, b"\x01\r\n\x04")
        assert await asyncio.wait_for(received.get(), SOON_S) == b"\x01\r\n\x04"
        port.write(b"\x03\r\xff")
        assert os.read(host, 10) == b"\x03\r\xff"
        os.close(host)
        for _ in range(50):
            port.write(b"x" * 1000)
        before = (tmp_path / "line").readlink()
        port.close()
        port.open()
        assert (tmp_path / "line").exists()
        assert before.is_absolute()
    finally:
        port.close()


async def test_bus_frames_round_trip() -> None:
    reader = asyncio.StreamReader()
    rows = np.arange(12.0).reshape(3, 4)
    reader.feed_data(runtime.pack_json({"mark": 1.5}) + runtime.pack_rows(rows) + runtime.pack_json({"event": "x"}))
    reader.feed_eof()
    assert await runtime.read_frame(reader) == {"mark": 1.5}
    got = await runtime.read_frame(reader)
    assert np.array_equal(got, rows)
    assert await runtime.read_frame(reader) == {"event": "x"}
    assert await runtime.read_frame(reader) is None


def reported(tmp_path: Path, text: str) -> list[str]:
    """Problems of a SIM.toml."""
    path = tmp_path / "sim.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_config(path)
    return str(caught.value).replace(f"{path}:", "").splitlines()


@pytest.mark.parametrize(
    ("text", "where"), [("[plant]\nsped = 1", "plant.sped"), ("[plant]\nspeed = 0", "plant.speed")]
)
def test_a_wrong_key_or_value_is_named(tmp_path: Path, text: str, where: str) -> None:
    assert where in reported(tmp_path, text)[0]


SENSELESS = {
    'device = "robot"\nwhat = "drop"': "3: fault.what: nothing says when to drop; add at_s",
    'device = "robot"\nwhat = "drop"\nrate = 2': "4: fault.rate: 2 is out of range; must be at most 1",
    'device = "robot"\nwhat = "dorp"\nrate = 0.1': "3: fault.what: 'dorp' is not allowed; must be",
    'device = "robot"\nwhat = "drop"\nat_s = 1.0\nframe = 2': "5: fault.frame: it cannot begin by at_s and by frame",
    'device = "robot"\nwhat = "drop"\nframe = 2\nrate = 0.1': "5: fault.rate: does not go with frame",
    'device = "robot"\nwhat = "hang"\nrate = 0.1': "4: fault.rate: means nothing for hang; it is for drop",
    'device = "robot"\nwhat = "reboot"\nat_s = 1.0\nduration_s = 1.0': "5: fault.duration_s: means nothing for reboot",
    'device = "robot"\nwhat = "estop"\nat_s = 1.0\nduration_s = 1.0': "5: fault.duration_s: means nothing for estop",
    'device = "robot"\nwhat = "manual"\nat_s = 1.0': "3: fault.what: the robot cannot manual; it can override",
    'device = "robot"\nwhat = "delay"\nrate = 0.1': "1: fault.by_s: delay needs it, or jitter_s",
    'device = "actuator"\nwhat = "drift"\nat_s = 1.0': "1: fault.drift_n_s: drift needs it",
    'device = "robot"\nwhat = "exception"\nrate = 0.1\ndirection = "to_device"': "5: fault.direction: exception",
    'device = "robot"\nlink = "rtde"\nwhat = "reboot"\nat_s = 1.0': "3: fault.link: means nothing for reboot",
    'device = "robot"\nlink = "rtde"\nwhat = "hang"\nat_s = 1.0': "3: fault.link: this robot has no named links",
    'device = "robot"\nwhat = "freeze"\nat_s = 1.0': "3: fault.what: the robot cannot freeze; it can override",
    'device = "robot"\nwhat = "override"\nat_s = 1.0': "1: fault.percent: override needs it",
    'device = "robot"\nwhat = "override"\nat_s = 1.0\npercent = -1': "5: fault.percent: -1 is out of range",
    'device = "robot"\nwhat = "stand"\nat_s = 1.0\npercent = 0': "5: fault.percent: means nothing for stand",
    'device = "actuator"\nwhat = "stand"\nat_s = 1.0': "3: fault.what: the actuator cannot stand; it can freeze",
    'device = "robot"\nwhat = "override"\nat_s = 1.0\npercent = 50\nreported = false\n[robot]\nkind = "linuxcnc"': (
        "6: fault.reported: a real LinuxCNC reports"
    ),
    'device = "actuator"\nwhat = "halt"\nat_s = 1.0': "3: fault.what: the actuator cannot halt; it can freeze",
    'device = "robot"\nwhat = "wrong_unit"\nrate = 0.1': "3: fault.what: robot_link has no wrong unit",
    'device = "loader"\nwhat = "drop"\nrate = 0.1': "2: fault.device: there is no loader in this cell; add [loader]",
    'device = "robot"\nwhat = "drop"\nrate = 0.1\n[robot]\nkind = "linuxcnc"': "2: fault.device: a real LinuxCNC",
    'device = "robot"\nwhat = "exception"\nrate = 0.1\n[robot]\nkind = "opcua"': "3: fault.what: opcua has no",
}


@pytest.mark.parametrize("text", SENSELESS)
def test_a_fault_that_makes_no_sense_is_refused_by_name_with_its_line(tmp_path: Path, text: str) -> None:
    (said,) = reported(tmp_path, f"[[fault]]\n{text}\n")
    assert said.startswith(SENSELESS[text]), said


@pytest.mark.parametrize(("lines", "protocol"), [("[lines]\n", "lines"), ("[modbus]\n", "modbus_rtu")])
def test_a_profiled_drive_speaks_what_its_profile_says(tmp_path: Path, lines: str, protocol: str) -> None:
    (tmp_path / "profile.toml").write_text(lines)
    (tmp_path / "sim.toml").write_text('[spindle]\nkind = "profile"\n')
    assert protocols(load_simulator(tmp_path / "sim.toml"), "spindle") == {"": protocol}


def test_every_fault_of_the_file_is_reported_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "sim.toml"
    path.write_text('[plant]\nspeed = "60"\nsede = 1\n[robot]\nx_mm = [1.0]\n')
    with pytest.raises(ConfigError) as caught:
        load_simulator(path)
    said = str(caught.value).replace(str(path), "S").splitlines()
    assert said[0] == "S:2: plant.speed: must be a number, not the string '60'"
    assert said[1].startswith("S:3: plant.sede: unknown key; did you mean 'seed'? Known here: 'aperture_mm', ")
    assert said[2] == "S:5: robot.x_mm: has too few entries: [1.0]; add the others"


@pytest.mark.parametrize("text", ["[plant", None])
def test_no_config(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "sim.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=r"sim\.toml"):
        load_simulator(path)


def test_an_empty_config_is_the_demo(tmp_path: Path) -> None:
    path = tmp_path / "sim.toml"
    path.write_text("")
    assert load_simulator(path).model_dump() == SimConfig().model_dump()
