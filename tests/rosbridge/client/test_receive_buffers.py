"""Memory is not mapped anew for every message."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path
from typing import List

import pytest
from harness.rosbridge_client import ForeignServer, Watched, scenario, until

from robot_health_monitor.rosbridge.client import connection

MODULE = Path(__file__).resolve().parents[3] / "rosbridge" / "client" / "receive_buffers.py"
MESSAGES = 500
PROGRAM = f"""
import resource, runpy, socket

def faults():
    begin = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range({MESSAGES}):
        sender.send(b"x" * 70)
        receiver.recv(256 * 1024)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - begin

sender, receiver = socket.socketpair()
before = faults()
runpy.run_path({str(MODULE)!r})["keep_receive_buffers_on_heap"]()
print(before, faults())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc maps memory for each buffer")
def test_receiving_a_small_message_causes_no_page_fault() -> None:
    # In a new process with few imports: any larger block that was freed before has the same effect.
    program = [sys.executable, "-I", "-c", PROGRAM]
    done = subprocess.run(program, stdout=subprocess.PIPE, text=True, timeout=60.0, check=True)
    before, after = map(int, done.stdout.split())
    assert before >= MESSAGES
    assert after < MESSAGES / 10


def test_a_connection_sees_to_it_before_it_receives(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: List[int] = []

    @scenario
    async def run() -> None:
        server = ForeignServer()
        watched = Watched(await server.start())
        monkeypatch.setattr(connection, "keep_receive_buffers_on_heap", lambda: calls.append(len(server.requests)))
        await until(lambda: watched.ups == [True])
        await watched.close()
        await server.close()

    run()
    assert calls == [0]
