"""The worker process: results and errors come back, limits of CPU time are kept, the loop never waits."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from polishd.daemon.runtime.compute import Compute
from polishd.daemon.runtime.process import BEHIND
from polishd.model.errors import ComputeError, MapError
from polishd.pipeline import dwell_step, steps
from polishd.pipeline.recipe import CpuLimit
from polishd.util.worker_process import process_cpu_s
from tests.unit.daemon.small_job import small_map, small_program, small_recipe


def _jobs() -> ModuleType:
    """The worker must import the functions by the name that we give them."""
    folder = str(Path(__file__).parent)
    if folder not in sys.path:
        sys.path.append(folder)
    name = "jobs"
    spec = importlib.util.spec_from_file_location(name, Path(folder) / "jobs.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


jobs = _jobs()


@pytest.fixture
async def compute() -> AsyncIterator[Compute]:
    async with Compute() as found:
        yield found


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.full
async def test_what_a_dwell_was_solved_with_stays_in_the_worker(compute: Compute) -> None:
    recipe, program = small_recipe(), small_program()
    measured = await compute(steps.condition, recipe, small_map())
    solved = await compute(dwell_step.solve, recipe, program, measured)
    assert not solved.answer.effect.here
    plan = await compute(steps.rewrite, recipe, program, solved, "small.rnc")
    answer = steps.effect_of(recipe, program, measured.grid)
    np.testing.assert_allclose(plan.predicted_removal_nm, answer.removal_nm(plan.expected_time_s), rtol=1e-12)
    with pytest.raises(ComputeError):
        await compute(jobs.be_killed)
    again = await compute(steps.rewrite, recipe, program, solved, "small.rnc")
    np.testing.assert_allclose(again.predicted_removal_nm, plan.predicted_removal_nm, rtol=1e-12)


@pytest.mark.full
async def test_arrays_go_and_come_back(compute: Compute) -> None:
    values = np.arange(600_000.0).reshape(600, 1000)
    doubled = await compute(jobs.double, values)
    np.testing.assert_array_equal(doubled, np.arange(600_000.0).reshape(600, 1000) * 2)
    assert values[0, 1] == 1.0
    doubled[0, 0] = 7.0  # writable


@pytest.mark.full
async def test_started_lazily_and_kept_warm(compute: Compute) -> None:
    assert compute.pid is None
    await compute.start()
    first = compute.pid
    assert first is not None
    await compute.start()
    assert await compute(jobs.pid) == first == await compute(jobs.pid) == compute.pid
    assert first != os.getpid()


@pytest.mark.full
async def test_printing_does_not_disturb(compute: Compute, capfd: pytest.CaptureFixture[str]) -> None:
    assert await compute(jobs.say, "hello") == "hello"
    assert await compute(jobs.say, "again") == "again"
    await compute.close()
    captured = capfd.readouterr()
    assert captured.out == ""
    assert "raw" in captured.err


@pytest.mark.full
async def test_numerical_threads_are_limited() -> None:
    async with Compute(threads=2) as compute:
        assert await compute(jobs.variable, "OPENBLAS_NUM_THREADS") == "2"
        assert await compute(jobs.variable, "OMP_NUM_THREADS") == "2"


@pytest.mark.full
async def test_our_errors_come_back_as_themselves(compute: Compute) -> None:
    with pytest.raises(MapError, match="a hole") as caught:
        await compute(jobs.bad_map)
    assert type(caught.value) is MapError
    assert caught.value.args == ("a hole",)
    assert caught.value.__notes__ == ["at 3, 4"]


@pytest.mark.full
async def test_other_errors_are_compute_errors_with_their_traceback(compute: Compute) -> None:
    with pytest.raises(ComputeError, match="divide failed: ZeroDivisionError: float division by zero") as caught:
        await compute(jobs.divide, 1.0, 0.0)
    assert "return a / b" in caught.value.__notes__[0]
    assert await compute(jobs.divide, 1.0, 2.0) == 0.5


@pytest.mark.full
async def test_what_cannot_travel_is_an_error_and_the_worker_stays(compute: Compute) -> None:
    with pytest.raises(ComputeError, match="this and that"):
        await compute(jobs.stubborn)
    with pytest.raises(ComputeError, match="the result cannot be sent back"):
        await compute(jobs.unpicklable)
    pid = compute.pid
    with pytest.raises(ComputeError, match="cannot be sent to the worker"):
        await compute(lambda: None)
    assert await compute(jobs.pid) == pid


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(
    "job", [jobs.burn_on, jobs.threads_burn_on, jobs.ignore_everything], ids=lambda job: job.__name__
)
async def test_killed_when_its_cpu_time_is_used_and_restarted(compute: Compute, job: Callable[[], None]) -> None:
    await compute.start()
    before = compute.pid
    assert before is not None
    with pytest.raises(
        ComputeError, match=rf"{job.__name__}: the compute worker exceeded its limit: .* s of CPU"
    ) as caught:
        await compute(job, within_s=CpuLimit(0.2, "dwell.cpu_limit_s"))
    assert re.search(r"\(limit 0\.2 s\) in .*\(limit 62 s\)\. Increase dwell\.cpu_limit_s\.", str(caught.value))
    assert not alive(before)
    assert compute.pid not in {None, before}
    assert await compute(jobs.divide, 1.0, 2.0) == 0.5


@pytest.mark.full
async def test_one_that_sleeps_is_killed_at_the_backstop() -> None:
    async with Compute(backstop=lambda within_s: {50.0: 1.0}.get(within_s, 100.0)) as compute:
        await compute.start()
        before = compute.pid
        assert before is not None
        with pytest.raises(ComputeError, match=r"forever: .*0\.\d s of CPU .* in \d+\.\d s \(limit 1 s\)"):
            await compute(jobs.forever, within_s=50.0)
        assert not alive(before)


@pytest.mark.full
async def test_one_that_is_starved_gets_its_cpu_time(compute: Compute) -> None:
    """Stopped for longer than its limit, as a busy machine may leave it."""
    await compute.start()
    worker = compute.pid
    assert worker is not None
    call = asyncio.create_task(compute(jobs.burn, 0.4, within_s=0.8))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    os.kill(worker, signal.SIGSTOP)
    ended, _ = await asyncio.wait({call}, timeout=1.2)
    os.kill(worker, signal.SIGCONT)
    assert not ended, "it must still be there"
    assert await call == worker


@pytest.mark.full
async def test_starting_does_not_count(compute: Compute, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sitecustomize.py").write_text("import time\nwhile time.process_time() < 1.0:\n    pass\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert await compute(jobs.divide, 1.0, 2.0, within_s=0.5) == 0.5
    assert compute.pid is not None
    assert process_cpu_s(compute.pid) > 1.0


@pytest.mark.full
async def test_the_loop_comes_before_computing(compute: Compute) -> None:
    assert await compute(jobs.nice) == os.getpriority(os.PRIO_PROCESS, 0) + BEHIND


@pytest.mark.full
async def test_a_ready_worker_has_numpy(compute: Compute) -> None:
    assert await compute(eval, "'numpy' in __import__('sys').modules and 'scipy.sparse' in __import__('sys').modules")


@pytest.mark.full
async def test_a_worker_that_cannot_start_is_reported(
    compute: Compute, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text("import os\nos._exit(7)\n")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(str(tmp_path))
        with pytest.raises(ComputeError, match="the compute worker did not start: ended with exit code 7"):
            await compute(jobs.pid)
    assert await compute(jobs.divide, 1.0, 2.0) == 0.5


@pytest.mark.full
async def test_a_dead_worker_is_an_error_and_is_replaced(compute: Compute) -> None:
    with pytest.raises(ComputeError, match="die: the compute worker ended with exit code 3"):
        await compute(jobs.die, 3)
    with pytest.raises(ComputeError, match="be_killed: the compute worker was ended by SIGKILL"):
        await compute(jobs.be_killed)
    assert await compute(jobs.divide, 1.0, 2.0) == 0.5
    pid = compute.pid
    assert pid is not None
    os.kill(pid, signal.SIGKILL)  # between calls
    await asyncio.to_thread(os.waitid, os.P_PID, pid, os.WEXITED | os.WNOWAIT)
    assert await compute(jobs.divide, 1.0, 4.0) == 0.25


@pytest.mark.full
async def test_cancelled_caller_ends_the_worker(compute: Compute) -> None:
    await compute.start()
    pid = compute.pid
    assert pid is not None
    task = asyncio.create_task(compute(jobs.forever))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert not alive(pid)
    assert await compute(jobs.divide, 1.0, 2.0) == 0.5


@pytest.mark.full
async def test_calls_take_turns(compute: Compute) -> None:
    answers = await asyncio.gather(*(compute(jobs.divide, float(n), 1.0) for n in range(5)))
    assert answers == [0.0, 1.0, 2.0, 3.0, 4.0]


@pytest.mark.full
async def test_closed_for_good() -> None:
    compute = Compute()
    await compute.start()
    pid = compute.pid
    assert pid is not None
    call = asyncio.create_task(compute(jobs.forever))
    await asyncio.sleep(0)
    await compute.close()
    await compute.close()
    assert not alive(pid)
    with pytest.raises(ComputeError, match=r"SIGKILL \(by polishd\)"):
        await call
    with pytest.raises(ComputeError, match="the compute worker is closed"):
        await compute(jobs.pid)


@pytest.mark.full
async def test_the_loop_runs_on_beside_a_call(compute: Compute) -> None:
    """The loop ticks at the same time as the worker works: it would not once, if a call blocked it."""
    await compute.start()
    call = asyncio.create_task(compute(jobs.double, np.zeros(4_000_000)))
    ticks = 0
    while not call.done():
        ticks += 1
        await asyncio.sleep(0)
    assert ticks > 10
    assert (await call).size == 4_000_000


DAEMON = """
import asyncio, sys
sys.path.insert(0, sys.argv[1])
import jobs
from polishd.daemon.runtime.compute import Compute
async def main():
    compute = Compute()
    print(await compute(jobs.pid), flush=True)
    await compute(jobs.forever)
asyncio.run(main())
"""


@pytest.mark.full
@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's parent-death signal")
def test_worker_does_not_outlive_a_killed_daemon() -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", DAEMON, str(Path(__file__).parent)]
    with subprocess.Popen(command, stdout=-1, text=True, env=environment) as daemon:
        assert daemon.stdout is not None
        worker = int(daemon.stdout.readline())
        daemon.send_signal(signal.SIGKILL)
    while alive(worker):  # pytest's timeout is the limit
        time.sleep(0.005)


def _too_much() -> None:
    """With a memory limit, such as that of a control group or a small computer."""
    with Path("/proc/self/statm").open() as file:
        held = int(file.read().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (held + (64 << 20), before[1]))
    try:
        np.ones(1 << 28)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.mark.full
async def test_a_worker_without_memory_is_an_error_and_stays(compute: Compute) -> None:
    with pytest.raises(ComputeError, match=r"_too_much failed: \S*MemoryError: Unable to allocate 2\.00 GiB"):
        await compute(_too_much)
    pid = compute.pid
    assert await compute(os.getpid) == pid
