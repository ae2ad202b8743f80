"""A command of the user's, as a step of the recipe: run in a process group of its own, ended in time."""

from __future__ import annotations

import asyncio
import os
import signal
from asyncio.subprocess import Process
from collections.abc import Mapping
from contextlib import suppress

from polishd.model.errors import HandlingError
from polishd.model.handling import HandlingStep

MOST_SAID = 400
"""Characters of its last line."""


async def run_command(name: str, step: HandlingStep, environment: Mapping[str, str]) -> None:
    """Run it to its end; HandlingError where it cannot be started, fails, or takes too long.

    Whatever ends the wait before its end, the command and all that it started are killed.
    """
    process = await _started(name, step, environment)
    done = False
    try:
        async with asyncio.timeout(step.within_s):
            said, _ = await process.communicate()
        done = True
    except TimeoutError:
        raise HandlingError(
            f"{name}: {step.command[0]} was not done after {step.within_s:g} s (between.{name}.within_s), and was "
            "killed; see to it, then polishd resume runs it again"
        ) from None
    finally:
        if not done:
            await _kill(process)
    if process.returncode:
        last = said.decode(errors="replace").strip().rpartition("\n")[2][-MOST_SAID:]
        raise HandlingError(
            f"{name}: {step.command[0]} ended with {process.returncode}: {last or 'it said nothing'}; see to it, then "
            "polishd resume runs it again"
        )


async def _started(name: str, step: HandlingStep, environment: Mapping[str, str]) -> Process:
    starting = asyncio.ensure_future(
        asyncio.create_subprocess_exec(
            *step.command,
            cwd=step.folder,
            env={**os.environ, **environment},
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            start_new_session=True,
        )
    )
    try:
        return await asyncio.shield(starting)
    except (OSError, ValueError) as error:
        raise HandlingError(
            f"{name}: {step.command[0]}: cannot be run: {error}; mend between.{name}.command"
        ) from error
    except asyncio.CancelledError:
        await asyncio.wait({starting})  # it may run already, and asyncio by itself would kill nothing that it started
        if starting.exception() is None:
            await _kill(starting.result())
        raise


async def _kill(process: Process) -> None:
    """With all that it started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    await process.wait()
