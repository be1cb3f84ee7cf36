"""A function that hangs delays neither the loop nor the end of the process."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from robot_health_monitor.rosbridge.daemon_thread import run_in_daemon_thread

ROOT = str(Path(__file__).resolve().parents[2])


def test_the_result_and_the_exception_arrive() -> None:
    async def run() -> None:
        assert await run_in_daemon_thread(lambda: threading.current_thread().daemon) is True
        with pytest.raises(ZeroDivisionError):
            await run_in_daemon_thread(lambda: 1 // 0)

    asyncio.run(run())


def test_a_cancelled_wait_ignores_the_result() -> None:
    async def run() -> None:
        release = threading.Event()
        task = asyncio.ensure_future(run_in_daemon_thread(release.wait))
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait({task})
        assert task.cancelled()
        release.set()
        assert await run_in_daemon_thread(lambda: 1) == 1

    asyncio.run(run())


def test_a_function_that_hangs_does_not_delay_the_exit() -> None:
    program = (
        "import asyncio, threading\n"
        "from robot_health_monitor.rosbridge.daemon_thread import run_in_daemon_thread\n"
        "async def run():\n"
        "    await asyncio.wait({asyncio.ensure_future(run_in_daemon_thread(threading.Event().wait))}, timeout=0.01)\n"
        "asyncio.run(run())\n"
        "print('ended')\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (ended.stdout, ended.stderr) == ("ended\n", "")
