"""Black boxes: random ones give the same alert lines in a replay; after a kill every file is complete or gone."""

from __future__ import annotations

import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from harness.black_boxes import KILLED, RecordedRobot, recorded
from harness.random_black_boxes import check_random_black_box
from harness.waiting import wait_for


def run(boxes: int, kills: int, seed: int) -> list[str]:
    """Replays random black boxes, and kills a process that writes one; returns what was wrong."""
    violations = []
    for number in range(boxes):
        with tempfile.TemporaryDirectory() as folder:
            try:
                check_random_black_box(Path(folder), seed + number)
            except AssertionError as error:
                violations.append(f"black box {seed + number}: {error}")
    choices = random.Random(seed)
    completed = 0
    for _ in range(kills):
        with tempfile.TemporaryDirectory() as folder:
            completed += _kill(Path(folder), choices.uniform(0.0, 1.0))
    print(f"black boxes: {boxes} replayed, {kills} killed, of which {completed} were completed", flush=True)
    return violations


def _kill(folder: Path, delay_s: float) -> int:
    """Kills a process that writes a file; returns how many files the next start completed. Raises AssertionError."""
    process = subprocess.Popen([sys.executable, "-c", KILLED.format(folder=str(folder))], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"alert\n"
    time.sleep(delay_s)
    process.kill()
    process.wait()
    process.stdout.close()
    robot = RecordedRobot(folder)
    wait_for(lambda: not list(folder.glob("*.part")))
    files = robot.files()
    assert all(recorded(file) for file in files)
    assert dict(robot.operations.faults.current()) == {}
    robot.close()
    return len(files)
