"""Files that crash, hang or fill the process they are read in are refused, and the next file is read."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.api import MapError, SurfaceMap, SurfaceReader
from polishd.plugins.interferometer.formats import sandbox
from polishd.plugins.interferometer.map_files import read_map
from tests.unit.plugins.interferometer import crashing_parsers

ROOT = Path(__file__).resolve().parents[5]


@pytest.fixture(autouse=True, scope="module")
def _worker_that_finds_the_tests() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT))
        sandbox.close()
        yield
        sandbox.close()


def read(tmp_path: Path, what: str, **bounds: Any) -> SurfaceMap:
    path = tmp_path / "map.bin"
    path.write_text(what)
    return sandbox.read(crashing_parsers.__name__, path, sandbox.USUAL._replace(**bounds))


@pytest.mark.full
def test_a_map_arrives_whole_and_can_be_changed(tmp_path: Path) -> None:
    surface = read(tmp_path, "map")
    assert (surface.pitch_mm, surface.path) == (0.5, tmp_path / "map.bin")
    np.testing.assert_array_equal(surface.height_nm, [[0, 1, 2], [3, 4, 5]])
    surface.height_nm[0, 0] = 7.0
    assert int(surface.part_id) != os.getpid()


@pytest.mark.full
def test_all_that_a_map_says_of_itself_arrives(tmp_path: Path) -> None:
    surface, sent = read(tmp_path, "all"), crashing_parsers.EVERYTHING
    np.testing.assert_array_equal(surface.height_nm, sent.height_nm)
    for one in fields(SurfaceMap):
        if one.name != "height_nm":
            assert getattr(surface, one.name) == getattr(sent, one.name), one.name
    assert read(tmp_path, "half").part_id == "a\\udcffb"


@pytest.mark.full
def test_the_head_of_a_map_has_every_field_but_the_heights_and_the_path() -> None:
    of_map = {one.name for one in fields(SurfaceMap)} - {"height_nm", "path"}
    assert {one.name for one in fields(sandbox.MapHead)} == of_map | {"has_path"}


def test_pixels_that_are_not_square_arrive_with_both_pitches(tmp_path: Path) -> None:
    sent = replace(crashing_parsers.EVERYTHING, pitch_mm=None, pitches_mm=(0.1, 0.2))
    text = json.dumps(sandbox._head(sent))
    surface = sandbox._map(sandbox._head_type().validate_python(json.loads(text)), sent.height_nm, tmp_path)
    assert (surface.pitch_mm, surface.pitches_mm) == (None, (0.1, 0.2))


@pytest.mark.full
def test_a_worker_that_a_file_has_taken_over_runs_nothing_in_the_daemon(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"broke the protocol|returned no valid map"):
        read(tmp_path, "pickle")
    assert [path.name for path in tmp_path.iterdir()] == ["map.bin"]


@pytest.mark.full
@pytest.mark.parametrize("what", ["no map", "huge"])
def test_an_answer_that_is_no_map_is_refused(tmp_path: Path, what: str) -> None:
    with pytest.raises(MapError, match=r"broke the protocol|returned no valid map"):
        read(tmp_path, what)
    assert read(tmp_path, "map").pitch_mm == 0.5


@pytest.mark.full
def test_a_worker_inherits_no_secrets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("SHOP_TOKEN", "MAIL_PASSWORD", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "s3cret")
    names = read(tmp_path, "environment", is_kept=False).part_id.split()
    assert "PATH" in names
    assert not {"SHOP_TOKEN", "MAIL_PASSWORD", "AWS_SECRET_ACCESS_KEY"} & set(names)


@pytest.mark.full
def test_a_file_is_called_as_it_was_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MapError, match=r"^map\.bin: .*torn"):
        read(Path(), "refuse")


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("crash", "was ended by SIGSEGV"),
        ("die", "was ended by SIGKILL"),
        ("spin", "exceeded its limit"),
        ("allocate", "exceeded its memory limit"),
        ("raise", "ZeroDivisionError: of a parser"),
        ("refuse", "torn"),
    ],
)
def test_what_a_parser_does_is_a_bad_map(tmp_path: Path, what: str, reason: str) -> None:
    with pytest.raises(MapError, match=reason) as caught:
        read(tmp_path, what, cpu_s=0.1)
    assert str(caught.value).startswith(f"{tmp_path / 'map.bin'}: ")
    assert read(tmp_path, "map").pitch_mm == 0.5


@pytest.mark.full
def test_one_that_only_waits_is_ended(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"limit 0\.1 s"):
        read(tmp_path, "wait", wall_s=0.1)
    assert read(tmp_path, "map").pitch_mm == 0.5


@pytest.mark.full
def test_the_worker_is_kept_and_replaced_when_it_has_gone(tmp_path: Path) -> None:
    first = int(read(tmp_path, "map").part_id)
    with pytest.raises(MapError, match="torn"):
        read(tmp_path, "refuse")
    assert int(read(tmp_path, "map").part_id) == first
    os.kill(first, signal.SIGKILL)
    os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
    assert int(read(tmp_path, "map").part_id) != first


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="No such file") as caught:
        sandbox.read(crashing_parsers.__name__, tmp_path / "none.bin")
    assert isinstance(caught.value.__cause__, FileNotFoundError)  # that is of the share, not of the map


def test_what_is_wrong_with_the_file_has_no_such_cause(tmp_path: Path) -> None:
    for what in ("refuse", "raise"):
        with pytest.raises(MapError) as caught:
            read(tmp_path, what)
        assert caught.value.__cause__ is None


def test_room_is_made_only_where_there_is_a_bound() -> None:
    from resource import RLIM_INFINITY, RLIMIT_AS, getrlimit

    before = getrlimit(RLIMIT_AS)
    assert before[0] == RLIM_INFINITY
    sandbox.raise_memory_limit(10)
    assert getrlimit(RLIMIT_AS) == before


@pytest.mark.full
def test_a_worker_that_is_not_kept_ends_with_its_file(tmp_path: Path) -> None:
    kept = int(read(tmp_path, "map").part_id)
    own = int(read(tmp_path, "map", is_kept=False).part_id)
    assert own != kept
    assert not Path(f"/proc/{own}").exists()
    assert int(read(tmp_path, "map").part_id) == kept


def test_what_ends_the_daemon_does_not_make_a_bad_map(tmp_path: Path) -> None:
    worker = int(read(tmp_path, "map").part_id)
    for everybodys in (signal.SIGINT, signal.SIGTERM):  # a terminal and systemd send them to the whole group
        os.kill(worker, everybodys)
    assert int(read(tmp_path, "map").part_id) == worker


@pytest.mark.full
def test_it_ends_when_no_caller_is_left(tmp_path: Path) -> None:
    (tmp_path / "map.bin").write_text("map")
    script = (
        "import os; from pathlib import Path; from polishd.plugins.interferometer.formats import sandbox as apart\n"
        f"surface = apart.read({crashing_parsers.__name__!r}, Path({str(tmp_path / 'map.bin')!r}))\n"
        "print(surface.part_id, flush=True); os.kill(os.getpid(), 9)"
    )
    done = subprocess.run([sys.executable, "-c", script], stdout=subprocess.PIPE, check=False)
    worker = int(done.stdout)
    with suppress(ProcessLookupError):  # it may have gone already
        gone = os.pidfd_open(worker)
        assert select.select([gone], [], [], 30.0)[0]
        os.close(gone)


def test_a_worker_that_cannot_start_says_nothing_about_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sandbox, "TARGET", "no_such_module:start")
    reader = SurfaceReader(
        "apart", lambda *_: True, lambda path: sandbox.read("any", path, sandbox.ResourceLimits(is_kept=False))
    )
    path = tmp_path / "map.bin"
    path.write_text("map")
    with pytest.raises(MapError, match="did not start: ended with exit code 1"):
        reader.read(path)
    with pytest.raises(OSError, match="did not start"):
        read_map(path, [reader])


@pytest.mark.full
def test_a_path_is_of_the_folder_where_it_was_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read(tmp_path, "map")
    monkeypatch.chdir(tmp_path)
    assert sandbox.read(crashing_parsers.__name__, Path("map.bin")).pitch_mm == 0.5


@pytest.mark.full
def test_an_interrupted_read_is_not_the_next_ones_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = int(read(tmp_path, "map").part_id)

    def interrupted(*_: object) -> bool:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("polishd.util.array_stream.read", interrupted)
        with pytest.raises(KeyboardInterrupt):
            read(tmp_path, "refuse")
    assert not Path(f"/proc/{first}").exists()
    assert int(read(tmp_path, "map").part_id) != first


@pytest.mark.full
def test_no_reader_waits_for_the_file_of_another(tmp_path: Path) -> None:
    """Two cells in one process: a file of the one hangs, and the other's is read meanwhile; then both are served."""
    hung = tmp_path / "hung.bin"
    os.mkfifo(hung)
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(sandbox.read, crashing_parsers.__name__, hung)
        with hung.open("w") as pipe:  # opens once its worker has
            other = int(read(tmp_path, "map").part_id)
            assert not waiting.done()
            pipe.write("map")
        assert int(waiting.result().part_id) != other


@pytest.mark.full
def test_many_threads_get_each_their_own_map_and_no_files_stay_open(tmp_path: Path) -> None:
    texts = ["map", "refuse", "raise", "map"] * 6
    paths = [tmp_path / f"{number}.bin" for number in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text)
    sandbox.close()
    before = len(list(Path("/proc/self/fd").iterdir()))

    def outcome(path: Path) -> str:
        try:
            return str(sandbox.read(crashing_parsers.__name__, path).path)
        except MapError as error:
            return str(error).partition(":")[0]

    with ThreadPoolExecutor(6) as pool:
        assert list(pool.map(outcome, paths)) == [str(path) for path in paths]
    sandbox.close()
    assert len(list(Path("/proc/self/fd").iterdir())) == before
