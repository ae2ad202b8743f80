"""The benchmark harness: what a race measures, which processes it stops, and what it writes."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rich.console import Console

from benchmarks import __main__ as bench
from benchmarks.harness import Row, cpu_seconds, race
from docs.reference.cost import lines_of
from docs.reference.performance import read, table


def burn(seconds: float) -> None:
    """Use so much CPU time."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def nap() -> None:
    """Let time pass and use none."""
    time.sleep(0.3)


class TestRow:
    def test_the_ratio_is_the_fastest_peer_over_ours(self) -> None:
        assert Row("a", 2.0, {"slow": 10.0, "quick": 6.0}).ratio == 3.0

    def test_a_peer_that_did_not_finish_does_not_count(self) -> None:
        assert Row("a", 2.0, {"stuck": None, "slow": 10.0}).ratio == 5.0

    @pytest.mark.parametrize("row", [Row("a", 2.0, {}), Row("a", 2.0, {"stuck": None}), Row("a", 0.0, {"b": 1.0})])
    def test_there_may_be_no_ratio(self, row: Row) -> None:
        assert row.ratio is None

    def test_json_has_the_agreed_keys(self) -> None:
        row = Row("a", 1.0, {"b": 2.0, "c": None}, "nm")
        common = {"name": "a", "ours": 1.0, "peers": {"b": 2.0, "c": None}, "unit": "nm", "ratio": 2.0}
        assert row.as_json() == {**common, "quartiles": {}}


class TestCpuSeconds:
    def test_work_is_counted(self) -> None:
        cost = cpu_seconds(lambda: burn(0.2), 10)
        assert cost is not None
        assert 0.2 <= cost < 0.4

    def test_waiting_is_not(self) -> None:
        cost = cpu_seconds(nap, 10)
        assert cost is not None
        assert cost < 0.1

    @pytest.mark.full
    def test_the_work_of_a_child_that_it_waits_for_is_counted(self) -> None:
        code = "import time\nwhile time.process_time() < 0.3: pass"
        cost = cpu_seconds(lambda: subprocess.run([sys.executable, "-c", code], check=True), 10)
        assert cost is not None
        assert cost >= 0.3

    @pytest.mark.full
    def test_a_run_over_the_cap_is_killed_with_its_children(self, tmp_path: Path) -> None:
        def hang() -> None:
            child = subprocess.Popen(["sleep", "60"])
            (tmp_path / "pids").write_text(f"{os.getpid()} {child.pid}")
            child.wait()

        before = time.monotonic()
        assert cpu_seconds(hang, 1.0) is None
        assert time.monotonic() - before < 10
        for pid in (tmp_path / "pids").read_text().split():
            assert self.ends(Path("/proc") / pid), f"{pid} still runs"

    @staticmethod
    def ends(process: Path) -> bool:
        """Whether it is gone soon; an orphan may stay as a zombie until its new parent asks."""
        for _ in range(100):
            try:
                if (process / "stat").read_text().rpartition(")")[2].split()[0] == "Z":
                    return True
            except OSError:
                return True
            time.sleep(0.02)
        return False

    def test_an_error_is_not_a_time(self) -> None:
        with pytest.raises(RuntimeError, match="ZeroDivisionError"):
            cpu_seconds(lambda: 1 / 0, 10)

    def test_a_sudden_death_is_not_a_time(self) -> None:
        with pytest.raises(RuntimeError, match="died without a word"):
            cpu_seconds(lambda: os._exit(3), 10)

    def test_every_run_starts_from_the_same_state(self) -> None:
        seen: list[int] = []

        def once() -> None:
            assert not seen
            seen.append(1)

        for _ in range(2):
            assert cpu_seconds(once, 10) is not None


class TestRace:
    @pytest.mark.full
    def test_ours_and_peers_run_in_turns(self) -> None:
        turns: list[str] = []
        row = race("r", nap, {"a": nap, "b": nap}, progress=turns.append)
        assert turns == [f"r: {who} {turn}/3" for turn in (1, 2, 3) for who in ("ours", "a", "b")]
        assert set(row.peers) == {"a", "b"}
        assert row.unit == "s"

    @pytest.mark.full
    def test_the_quicker_wins(self) -> None:
        row = race("r", lambda: burn(0.05), {"slow": lambda: burn(0.2)})
        assert row.ratio is not None
        assert row.ratio > 2

    def test_the_median_is_taken(self, monkeypatch: pytest.MonkeyPatch) -> None:
        costs = iter([3.0, 30.0, 100.0, 10.0, 2.0, 20.0])
        monkeypatch.setattr("benchmarks.harness.cpu_seconds", lambda run, cap_s: next(costs))
        row = race("r", nap, {"peer": nap}, once_above_s=1000)
        assert row == Row("r", 3.0, {"peer": 20.0}, quartiles={"ours": (2.5, 51.5), "peer": (15.0, 25.0)})

    @pytest.mark.full
    def test_a_slow_peer_runs_once(self) -> None:
        turns: list[str] = []
        row = race("r", nap, {"slow": lambda: burn(0.2)}, progress=turns.append, once_above_s=0.1)
        assert [turn for turn in turns if "slow" in turn] == ["r: slow 1/3"]
        assert row.peers["slow"] is not None

    @pytest.mark.full
    def test_a_stuck_peer_did_not_finish(self) -> None:
        turns: list[str] = []
        row = race("r", lambda: burn(0.01), {"stuck": lambda: time.sleep(60)}, progress=turns.append, peer_cap_s=0.5)
        assert row.peers == {"stuck": None}
        assert [turn for turn in turns if "stuck" in turn] == ["r: stuck 1/3"]

    def test_ours_must_finish(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("benchmarks.harness.OURS_CAP_S", 0.3)
        with pytest.raises(TimeoutError, match="ours did not finish"):
            race("r", lambda: time.sleep(60), {})

    def test_a_failing_peer_fails_the_race(self) -> None:
        with pytest.raises(RuntimeError, match="ZeroDivisionError"):
            race("r", nap, {"broken": lambda: 1 / 0})

    def test_too_few_repeats_are_refused(self) -> None:
        with pytest.raises(ValueError, match="at least 3"):
            race("r", nap, {}, repeats=2)

    def test_a_peer_cannot_be_called_ours(self) -> None:
        with pytest.raises(ValueError, match="ours"):
            race("r", nap, {"ours": nap})


GOOD = """
from benchmarks.harness import Row

def rows(progress):
    progress("running")
    yield Row("good", 1.0, {"peer": 2.0, "stuck": None}, "nm")
"""
BAD = GOOD + "    raise ValueError('half way')\n"


class TestRunning:
    @pytest.fixture
    def package(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        """A folder ``races`` with benchmark modules and one that is none, on the path."""
        folder = tmp_path / "races"
        folder.mkdir()
        for name, text in {"__init__": "", "bench_good": GOOD, "bench_bad": BAD, "helper": "1 / 0"}.items():
            (folder / f"{name}.py").write_text(text)
        monkeypatch.syspath_prepend(tmp_path)
        for name in ("races", "races.bench_good", "races.bench_bad"):
            monkeypatch.delitem(sys.modules, name, raising=False)
        return folder

    def test_benchmarks_are_found(self, package: Path) -> None:
        assert bench.discover([str(package)]) == ["bad", "good"]
        assert bench.discover([str(package)], ["good"]) == ["good"]

    def test_an_unknown_name_is_refused(self, package: Path) -> None:
        with pytest.raises(SystemExit, match="there are: bad, good"):
            bench.discover([str(package)], ["worse"])

    def test_a_failure_stops_neither_the_others_nor_what_came_before(self, package: Path) -> None:
        console = Console(record=True, quiet=True)
        rows, complete = bench.run(["bad", "good"], console, package.name)
        assert [row.name for row in rows] == ["good", "good"]
        assert not complete

    def test_progress_and_failure_are_reported(self, package: Path, capsys: pytest.CaptureFixture[str]) -> None:
        bench.run(["bad"], Console(), package.name)
        output = capsys.readouterr().out
        assert "running" in output
        assert "half way" in output

    def test_a_row_is_kept_as_it_comes_and_the_others_stay(self, package: Path, tmp_path: Path) -> None:
        path = tmp_path / "data" / "benchmarks.jsonl"
        bench.Kept(path).add("other", Row("other", 3.0, {}))
        bench.run(["bad"], Console(quiet=True), package.name, bench.Kept(path))
        good, other = read(path)
        assert (other["name"], good["name"], good["peers"]) == ("other", "good", {"peer": 2.0, "stuck": None})
        assert set(good) == {*Row("a", 1.0, {}).as_json(), "benchmark", "date", "load"}
        bench.Kept(path).add("other", Row("other", 2.0, {}))
        assert [row["ours"] for row in read(path)] == [1.0, 2.0]

    def test_a_complete_run_replaces_the_rows_of_its_benchmark_alone(self, package: Path, tmp_path: Path) -> None:
        path = tmp_path / "benchmarks.jsonl"
        for name in ("good", "bad", "other"):
            bench.Kept(path).add(name, Row("of an earlier version", 3.0, {}))
        bench.run(["good", "bad"], Console(quiet=True), package.name, bench.Kept(path))
        assert [(row["benchmark"], row["name"]) for row in read(path)] == [
            ("bad", "good"),  # it failed after this row, so what it had before stays
            ("bad", "of an earlier version"),
            ("good", "good"),
            ("other", "of an earlier version"),
        ]

    def test_rows_are_written_whole(self, tmp_path: Path) -> None:
        kept = bench.Kept(tmp_path / "benchmarks.jsonl")
        kept.add("a", Row("a", 1.0, {"b": None}))
        with pytest.raises(ValueError, match="JSON"):
            kept.add("a", Row("a", float("nan"), {}))
        assert read(tmp_path / "benchmarks.jsonl")[0]["ours"] == 1.0

    @pytest.mark.parametrize("line", ["{", "[]", '{"name": "a"}'])
    def test_a_broken_line_is_named(self, tmp_path: Path, line: str) -> None:
        path = tmp_path / "benchmarks.jsonl"
        path.write_text('{"benchmark": "a", "name": "a"}\n' + line + "\n")
        with pytest.raises(ValueError, match=r"benchmarks.jsonl:2: no row of a benchmark"):
            bench.Kept(path)

    def test_the_page_s_table_tells_all(self, tmp_path: Path) -> None:
        kept = bench.Kept(tmp_path / "benchmarks.jsonl")
        kept.add("a", Row("solve", 1.0, {"quick": 2.5, "stuck": None}, "s", {"ours": (0.9, 1.25)}))
        (row,) = table(read(tmp_path / "benchmarks.jsonl")).splitlines()[2:]
        assert row.startswith("| solve | 1 s (0.9 to 1.25) | quick 2.5 s; stuck did not finish | 2.5 | 20")

    def test_the_kept_rows_are_of_benchmarks_that_exist(self) -> None:
        names = {path.stem.removeprefix(bench.PREFIX) for path in Path(bench.__file__).parent.glob("bench_*.py")}
        rows = read()
        assert {row["benchmark"] for row in rows} <= names
        assert table(rows).count("\n") == len(rows) + 2

    def test_the_picture_of_the_cost_needs_its_rows(self) -> None:
        rows = read()
        assert len(lines_of(rows)["MB"]["discs, spot 10 mm"][0]) >= 3
        with pytest.raises(SystemExit, match=r"in s and MB: run make bench ARGS=size"):
            lines_of(row for row in rows if row["benchmark"] != "size")

    def test_what_takes_longest_is_run_by_name_only(self) -> None:
        folders = [str(Path(bench.__file__).parent)]
        assert "dwell_million" not in bench.discover(folders)
        assert bench.discover(folders, ["dwell_million"]) == ["dwell_million"]

    def test_the_table_tells_all(self) -> None:
        console = Console(record=True, width=100, file=io.StringIO())
        console.print(bench.table([Row("solve", 1.0, {"quick": 2.5, "stuck": None}, "nm")]))
        output = console.export_text()
        for word in ("solve", "1 nm", "quick 2.5 nm", "stuck did not finish"):
            assert word in output
