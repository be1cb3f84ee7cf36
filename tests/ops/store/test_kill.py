"""A monitor that is killed at any moment: nothing that was announced is missing from the history, nothing is twice."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from pathlib import Path

from harness.histories import opened, stored_texts

from robot_health_monitor.ops.store.database_file import reading

ROUNDS = 12

_WRITER = """
import sys
from pathlib import Path
from harness.histories import opened, transition
from robot_health_monitor.core.values.faults import Faults
from robot_health_monitor.ops.store import history as module
module.COMMIT_TIMEOUT_S = 600.0  # a busy machine must not look like a disk that hangs
history = opened(Path(sys.argv[1]), keep_days=1000.0)
robot = history.of_robot("r1")
number = robot.restore().get("battery_level", {"number": 0})["number"]
while True:
    number += 1
    robot.record(transition(number), {"number": number}, [(1.0, 2.0)] * 50)
    print(number, flush=True)
    if number % 3 == 0:
        robot.save({"temperature": {"after": number}})
"""


def test_killed_at_random_points(tmp_path: Path) -> None:
    file = tmp_path / "history.db"
    choose = random.Random(12)
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    announced = 0
    for _ in range(ROUNDS):
        command = [sys.executable, "-c", _WRITER, str(file)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, env=variables, text=True) as monitor:
            assert monitor.stdout is not None
            for _ in range(choose.randrange(1, 60)):
                announced = int(monitor.stdout.readline())
            monitor.kill()
            announced = int((monitor.stdout.read().split() or [announced])[-1])
            monitor.wait()
        numbers = [int(text.rpartition(" ")[2]) for text in stored_texts(file)]
        # The last one may have been stored, but not announced before the kill.
        assert numbers in (list(range(1, announced + 1)), list(range(1, announced + 2)))
        with reading(file) as connection:
            assert connection.execute("SELECT count(*) FROM evidence").fetchone() == (len(numbers),)
            assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    history = opened(file)
    state = history.of_robot("r1").restore()
    assert state["battery_level"] == {"number": len(numbers)}
    assert state["temperature"]["after"] in (len(numbers) // 3 * 3, len(numbers) // 3 * 3 - 3)
    history.close()
