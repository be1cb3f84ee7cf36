"""CPU time and memory of a replay, compared with rosbags reading the same recordings.

Every contestant runs in a separate process, one after the other. Parts of the table:

- a million Float32 samples on three topics: `robot-health replay`, judging included, against rosbags' AnyReader
  deserializing the same messages; and the memory of a replay of a tenth of them;
- a recording with 95 % of its bytes in images: `robot-health replay`, and only reading the watched messages, against
  AnyReader reading the watched messages;
- a day of ten signals at 10 Hz.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Sequence

from benchmarks.processes import compile_source
from benchmarks.table import Row, within

SAMPLES, DAY_S = 1_000_000, 86_400
TOPICS = ("/battery_level", "/temperature", "/cpu_usage")
FORMATS = (".bag", "MCAP", "sqlite3")
ROUNDS = 5
MEMORY_LIMIT_MB = 120.0
IMAGE_BYTES = 120_000
"""Size of an image. A hundred samples take up to 6 kB in a file, so that 95 % of its bytes are images."""
_NAMES = {
    "deserialize": "AnyReader, deserialized",
    "raw": "AnyReader, raw watched messages",
    "read": "recordings.reading, raw watched messages",
    "replay": "robot-health replay",
}
_MEASURE = """
import json, sys, time
from pathlib import Path
from rosbags.highlevel import AnyReader
from robot_health_monitor.cli.commands import replay_command
from robot_health_monitor.recordings import mcap_file
from robot_health_monitor.__main__ import main
from robot_health_monitor.recordings.reading import Recordings
kind, path = sys.argv[1:3]
began_s = time.process_time()
if kind == "replay":
    sys.argv = ["robot-health", "replay", path, "--fail-on", "never", "--json", *sys.argv[3:]]
    try:
        code = main()
    except SystemExit as end:
        code = end.code
    assert not code, code
elif kind == "read":
    with Recordings([path]) as recordings:
        wanted = [each for each in recordings.channels if each.type_name == "std_msgs/Float32"]
        for message in recordings.messages(dict.fromkeys(wanted)):
            pass
else:
    with AnyReader([Path(path)]) as reader:
        wanted = [each for each in reader.connections if each.msgtype == "std_msgs/msg/Float32"]
        for connection, _, data in reader.messages(connections=wanted):
            if kind == "deserialize":
                reader.deserialize(data, connection.msgtype)
used_s = time.process_time() - began_s
memory = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps([used_s, int(memory.split()[1]) / 1024]), file=sys.stderr)
"""
"""What one contestant does. Its memory includes that of all libraries, which every contestant imports."""


def rows() -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    compile_source(sys.executable)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for form in FORMATS:
            path = _write(folder / f"million{form}", form, TOPICS, SAMPLES, 1_000_000)
            yield from _compared(f"a million samples, {form}", path, "deserialize", {"replay": 1.6})
            path = _write(folder / f"tenth{form}", form, TOPICS, SAMPLES // 10, 1_000_000)
            used_s, memory_mb = _run("replay", path)
            yield Row(f"a tenth of them, {form}", _NAMES["replay"], f"{used_s:.2f} s")
            yield _memory(f"a tenth of them, {form}", "replay", memory_mb)
        for form in FORMATS:
            path = _write(folder / f"images{form}", form, TOPICS, 300_000, 10_000_000, IMAGE_BYTES)
            # SQLite reads past images at no cost, so a replay costs as much as without images.
            required = {"read": 1.3} if form == "sqlite3" else {"read": 1.3, "replay": 1.3}
            yield from _compared(f"95 % images, {form}", path, "raw", required)
        topics = [f"/signal{number}" for number in range(10)]
        path = _write(folder / "day", "MCAP", topics, DAY_S * 100, 10_000_000)
        thresholds = folder / "thresholds.yaml"
        signals = {topic[1:]: {"warn_above": 56.5, "stale_after_s": 5.0} for topic in topics}
        thresholds.write_text(json.dumps({"alert_system": {"ros__parameters": {"signals": signals}}}))
        used_s, memory_mb = _run("replay", path, "--thresholds", str(thresholds))
        what = "a day, ten signals at 10 Hz, MCAP"
        yield within(what, _NAMES["replay"], used_s, 120.0, "s")
        yield _memory(what, "replay", memory_mb)


def _run(kind: str, path: Path, *arguments: str) -> List[float]:
    """Returns the CPU time in s and the memory in MB of one contestant."""
    command = [sys.executable, "-c", _MEASURE, kind, str(path), *arguments]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False)
    last = done.stderr.strip().splitlines()[-1]
    if done.returncode:
        raise RuntimeError(last)
    return list(json.loads(last))


def _write(path: Path, form: str, topics: Sequence[str], count: int, period_ns: int, image_bytes: int = 0) -> Path:
    """Writes Float32 samples in turn, and after every hundred an image if `image_bytes` is set."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    store: Any = get_typestore(Stores.ROS1_NOETIC if form == ".bag" else Stores.ROS2_JAZZY)
    if form == ".bag":
        writer: Any = rosbag1.Writer(path)
    else:
        writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[form.upper()])
    serialize = store.serialize_ros1 if form == ".bag" else store.serialize_cdr
    float32 = "std_msgs/msg/Float32"
    payloads = [bytes(serialize(store.types[float32](50.0 + value), float32)) for value in range(7)]
    with writer:
        connections = [writer.add_connection(topic, float32, typestore=store) for topic in topics]
        images = writer.add_connection("/image", "std_msgs/msg/UInt8MultiArray", typestore=store)
        blob = bytes(image_bytes)  # no valid message: nothing decodes it
        for index in range(count):
            time_ns = 1_700_000_000_000_000_000 + index * period_ns
            writer.write(connections[index % len(connections)], time_ns, payloads[index % 7])
            if image_bytes and index % 100 == 0:
                writer.write(images, time_ns, blob)
    return path


def _compared(what: str, path: Path, peer: str, required: Mapping[str, float]) -> Iterator[Row]:
    """Yields the rows of a peer and of everything that is compared with it, `required` or not."""
    own = ("replay",) if peer == "deserialize" else ("read", "replay")
    rounds: List[Dict[str, List[float]]] = [{kind: _run(kind, path) for kind in (peer, *own)} for _ in range(ROUNDS)]
    yield Row(what, _NAMES[peer], f"{min(each[peer][0] for each in rounds):.2f} s")
    for kind in own:
        ratio = statistics.median(each[kind][0] / each[peer][0] for each in rounds)
        best_s = min(each[kind][0] for each in rounds)
        yield Row(what, _NAMES[kind], f"{best_s:.2f} s", ratio, required.get(kind), f"to {_NAMES[peer]}")
        yield _memory(what, kind, max(each[kind][1] for each in rounds))


def _memory(what: str, kind: str, memory_mb: float) -> Row:
    return within(f"{what}, memory", _NAMES[kind], memory_mb, MEMORY_LIMIT_MB, "MB")
