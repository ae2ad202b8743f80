"""Claims on device addresses: one program at a device, named to the other, and gone with its process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from polishd.model.errors import DeviceClaimed, LinkError
from polishd.util import address_claims
from polishd.util.address_claims import Claim, KeptClaims, claim, folder_key, serial_key, tcp_keys

COARSE = 5
"""CLOCK_REALTIME_COARSE of Linux, by which the kernel dates files; Python has no name for it."""
HOLDER = """\
import sys
from pathlib import Path
from polishd.util import address_claims
address_claims.FOLDERS = tuple(map(Path, sys.argv.pop().split(":")))
keep = address_claims.KeptClaims("north cell", "polishd run cell.toml")
with keep.keeping():
    address_claims.claim([sys.argv.pop()], "a device")
print("claimed", flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, ...]:
    found = tuple(tmp_path / name for name in ("lock", "shm"))
    for folder in found:
        folder.mkdir()
    monkeypatch.setattr(address_claims, "FOLDERS", found)
    return found


@contextmanager
def held_elsewhere(key: str, *folders: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process has that address."""
    command = [sys.executable, "-c", HOLDER, key, ":".join(map(str, folders))]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "claimed\n"
        try:
            yield process
        finally:
            process.kill()


def files(*folders: Path) -> list[Path]:
    return [file for folder in folders for file in (folder / "polishd").glob("*")]


def test_another_process_is_named_with_its_cell_and_kill_9_frees_the_address(folders: tuple[Path, ...]) -> None:
    with held_elsewhere("tcp:plc:502", *folders) as process:
        said = rf"tcp://plc:502: another program uses this device: pid {process.pid} \(polishd run cell.toml\), cell "
        with pytest.raises(DeviceClaimed, match=said + "'north cell'. Stop that program first."):
            claim(["tcp:plc:502"], "tcp://plc:502")
        claim(["tcp:plc:503"], "tcp://plc:503").release()
        process.send_signal(signal.SIGKILL)
        process.wait()
    claim(["tcp:plc:502"], "tcp://plc:502").release()


def test_it_is_held_per_process_and_freed_with_its_last_user(folders: tuple[Path, ...]) -> None:
    first, second = claim(["a", "b"], "one line"), claim(["a"], "one line")
    assert len(files(*folders)) == 4
    first.release()
    first.release()
    assert len(files(*folders)) == 2, "the second still has a"
    second.release()
    assert files(*folders) == [], "nothing is left behind"


def test_of_several_addresses_all_are_taken_or_none(folders: tuple[Path, ...]) -> None:
    with held_elsewhere("b", *folders), pytest.raises(DeviceClaimed):
        claim(["a", "b"], "two")
    with held_elsewhere("a", *folders):
        pass


def test_two_users_who_can_write_different_folders_meet_in_the_one_that_both_can(folders: tuple[Path, ...]) -> None:
    with held_elsewhere("tcp:plc:502", folders[1]), pytest.raises(DeviceClaimed):
        claim(["tcp:plc:502"], "tcp://plc:502")
    assert files(folders[0]) == []


def test_the_folder_is_shared_and_the_file_may_be_locked_by_another_user(folders: tuple[Path, ...]) -> None:
    held = claim(["a"], "a")
    assert (folders[0] / "polishd").stat().st_mode & 0o7777 == 0o1777
    assert [file.stat().st_mode & 0o777 for file in files(*folders)] == [0o666] * 2
    held.release()


def test_without_a_folder_nothing_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(address_claims, "FOLDERS", (tmp_path / "none",))
    monkeypatch.setattr(address_claims.tempfile, "gettempdir", lambda: str(tmp_path / "neither"))
    with pytest.raises(LinkError, match="cannot be claimed on this computer: no folder"):
        claim(["a"], "a")


def test_where_shared_folders_are_missing_the_temporary_one_serves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(address_claims, "FOLDERS", (tmp_path / "none",))
    monkeypatch.setattr(address_claims.tempfile, "gettempdir", lambda: str(tmp_path))
    held = claim(["a"], "a")
    assert len(files(tmp_path)) == 1
    held.release()


def test_a_link_in_the_shared_folder_is_not_followed(folders: tuple[Path, ...], tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    held = claim(["a"], "a")
    (name,) = {file.name for file in files(*folders)}
    held.release()
    (folders[0] / "polishd" / name).symlink_to(victim)
    claim(["a"], "a").release()
    assert victim.read_text() == "mine"


LOUD = {"pid": 7, "command": "x\x1b]0;y\x07", "cell": "c\x1b[2J"}


@pytest.mark.parametrize(
    ("written", "holder"),
    [
        (b"", "its process did not say who it is"),
        (b"[1]", "its process did not say who it is"),
        (
            json.dumps({"pid": 7, "command": "x\x1b]0;y\x07", "cell": "c\x1b[2J"}).encode(),
            r"pid 7 \(x\?\]0;y\?\), cell",
        ),
    ],
)
def test_what_the_holder_wrote_is_shown_without_control_characters(
    folders: tuple[Path, ...], written: bytes, holder: str
) -> None:
    with held_elsewhere("a", *folders):
        for file in files(*folders):
            file.write_bytes(written)
        with pytest.raises(DeviceClaimed, match=holder) as refused:
            claim(["a"], "a")
    assert str(refused.value).isprintable()


def test_a_cell_keeps_its_claims_while_links_come_and_go(folders: tuple[Path, ...]) -> None:
    kept = KeptClaims("cell")
    with kept.keeping():
        claim(["a"], "a").release()
        assert files(*folders)
        late = claim(["a"], "a")
    kept.release()
    assert files(*folders), "a connection is open still"
    late.release()
    assert files(*folders) == []


def test_after_its_end_a_cell_keeps_nothing(folders: tuple[Path, ...]) -> None:
    kept = KeptClaims("cell")
    with kept.keeping():
        kept.release()
        claim(["a"], "a").release()
    assert files(*folders) == []


def test_a_forked_child_does_not_keep_what_its_parent_gave_back(folders: tuple[Path, ...]) -> None:
    held = claim(["a"], "a")
    ready, wait = os.pipe(), os.pipe()
    if not (child := os.fork()):
        os.write(ready[1], b"x")
        os.read(wait[0], 1)
        os._exit(0)
    assert os.read(ready[0], 1) == b"x"
    held.release()
    with held_elsewhere("a", *folders):
        pass
    os.write(wait[1], b"x")
    os.waitpid(child, 0)
    assert isinstance(held, Claim)


def test_an_endpoint_has_one_name_however_it_is_written() -> None:
    here = tcp_keys("localhost", ["127.0.0.1", "::1"], 5000)
    assert here == tcp_keys("127.0.0.1", ["127.0.0.1"], 5000) == tcp_keys("::1", ["::1"], 5000)
    assert here == tcp_keys("::ffff:127.0.0.1", ["::ffff:127.0.0.1"], 5000) == tcp_keys("0.0.0.0", ["0.0.0.0"], 5000)
    assert tcp_keys("127.0.0.2", ["127.0.0.2"], 5000) != here
    assert tcp_keys("x", ["192.0.2.7", "2001:db8::7"], 5) == {"tcp:192.0.2.7:5", "tcp:2001:db8::7:5"}
    assert tcp_keys("PLC.", [], 5) == tcp_keys("plc", [], 5) == {"tcp:plc:5"}
    assert tcp_keys("plc", ["192.0.2.7"], 5, "1") != tcp_keys("plc", ["192.0.2.7"], 5, "2")


def test_a_port_has_one_name_whatever_link_leads_to_it(tmp_path: Path) -> None:
    master, slave = os.openpty()
    name = Path(os.ttyname(slave))
    (tmp_path / "by-id").symlink_to(name)
    assert serial_key(tmp_path / "by-id") == serial_key(name) != serial_key(Path("/dev/null"))
    (tmp_path / "gone").symlink_to(tmp_path / "nowhere")
    assert serial_key(tmp_path / "gone") == serial_key(tmp_path / "nowhere")
    os.close(master)
    os.close(slave)


def test_a_claim_does_not_refuse_the_next_terminal_of_its_number() -> None:
    """As where a simulated device ends before its driver is closed: the kernel gives the number to the next."""
    keys: dict[str, set[str]] = {}
    for _ in range(8):
        master, slave = os.openpty()
        name = os.ttyname(slave)
        keys.setdefault(name, set()).add(key := serial_key(Path(name)))
        os.write(master, b"x\n")
        os.read(slave, 8)
        assert serial_key(Path(name)) == key
        os.close(slave)
        os.close(master)
        tick = time.clock_gettime_ns(COARSE)
        while time.clock_gettime_ns(COARSE) - tick < 20_000_000:  # a file's time may lag behind this clock by a tick
            pass
    assert sum(map(len, keys.values())) == 8
    assert len(keys) < 8


def test_a_folder_has_one_name_whatever_link_leads_to_it(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "maps")
    assert folder_key(tmp_path / "link") == folder_key(tmp_path / "maps") != folder_key(tmp_path)
