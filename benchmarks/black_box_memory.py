"""Memory of a black box that records a camera: frames of 1 MB at 30 Hz, `memory_mb: 32`, before and after an alert.

A process grows by the largest private memory that it has while frames come and a recording is written, minus what it
had before the first frame. What a bare subscriber of the same bytes grows by is the middleware's: on ROS 2 its queue of
ten frames.
"""

from __future__ import annotations

import contextlib
import tempfile
import time
from pathlib import Path
from typing import Iterator

from benchmarks.pacing import CAMERA, LEVEL
from benchmarks.table import Row
from benchmarks.targets import Target

RATE_HZ = 30.0
MEMORY_MB = 32
AT_MOST_OF_MEMORY = 1.1
SETTLE_S = 5.0
SECONDS = 30
"""The memory is full after one, and the alert comes after half of them."""

PARAMETERS = """
alert_system:
  ros__parameters:
    ops: {ops}
    signals:
      battery_level: {{topic: {level}, type: std_msgs/Float32, warn_below: 20.0, stale_after_s: 0.0}}
"""
OPS = """
black_box: {{folder: {folder}, topics: [{camera}], memory_mb: {memory_mb}, after_s: 3, keep_mb: 400}}
"""


def rows(target: Target, seconds: int = SECONDS) -> Iterator[Row]:
    """Measures and yields the row of the table."""
    with contextlib.ExitStack() as running:
        folder = Path(running.enter_context(tempfile.TemporaryDirectory()))
        parameters, ops = folder / "parameters.yaml", folder / "ops.yaml"
        ops.write_text(OPS.format(folder=folder, camera=CAMERA, memory_mb=MEMORY_MB))
        parameters.write_text(PARAMETERS.format(ops=ops, level=LEVEL))
        processes = {
            "bare": target.peer("camera_subscriber"),
            "node": target.node("alert_system", "black_box", parameters=parameters),
        }
        for process in processes.values():
            running.callback(process.end)
        camera = target.peer("camera_publisher")
        running.callback(camera.end)
        time.sleep(SETTLE_S)
        before_mb = {name: process.own_mb() for name, process in processes.items()}
        growth_mb = dict.fromkeys(processes, 0.0)
        for _ in range(seconds):
            camera.order(f"{RATE_HZ} 1")
            for name, process in processes.items():
                growth_mb[name] = max(growth_mb[name], process.own_mb() - before_mb[name])
        recorded_mb = sum(file.stat().st_size for file in folder.glob("*.mcap")) / 1e6
    what = f"{target.name}, black box of a camera, 1 MB at {RATE_HZ:g} Hz, memory"
    added_mb = growth_mb["node"] - growth_mb["bare"]
    yield Row(what, "bare subscriber of bytes", f"{growth_mb['bare']:.1f} MB")
    remark = f"more than the bare subscriber, to memory_mb {MEMORY_MB}; {recorded_mb:.0f} MB recorded"
    yield Row(what, "alert_system adds", f"{added_mb:.1f} MB", added_mb / MEMORY_MB, AT_MOST_OF_MEMORY, remark)
