"""CPU time and memory of a replay, compared with rosbags reading the same recordings.

Every contestant runs in a separate process, one after the other (`python -m benchmarks.recordings CONTESTANT FILE`),
which imports the libraries of all. Parts of the table:

- a million Float32 samples on three topics: `robot-health replay`, judging included, against rosbags' AnyReader
  deserializing the same messages;
- a recording with 95 % of its bytes in images: `robot-health replay`, and only reading the watched messages, against
  AnyReader reading the watched messages;
- a day of ten signals at 10 Hz.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Iterator, Mapping, Sequence

from rosbags import rosbag1, rosbag2
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from benchmarks.processes import alert_system, compile_source, write_yaml
from benchmarks.table import ROOT, Row, beside, within
from robot_health_monitor.__main__ import main
from robot_health_monitor.cli.commands import replay_command  # noqa: F401  # the time of its import is not measured
from robot_health_monitor.recordings import mcap_file  # noqa: F401
from robot_health_monitor.recordings.reading import Recordings

SAMPLES, DAY_S = 1_000_000, 86_400
TOPICS = ("/battery_level", "/temperature", "/cpu_usage")
FORMATS = (".bag", "MCAP", "sqlite3")
IMAGE_BYTES = 120_000
"""Size of an image. A hundred samples take up to 6 kB in a file, so that 95 % of its bytes are images."""
DESERIALIZED, RAW = "AnyReader, deserialized", "AnyReader, raw watched messages"
READ, REPLAY = "recordings.reading, raw watched messages", "robot-health replay"
FLOAT32 = "std_msgs/msg/Float32"


def rows(rounds: int = 5) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    compile_source(sys.executable)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for form in FORMATS:
            path = _write(folder / f"million{form}", form, TOPICS, SAMPLES, 1_000_000)
            yield from _compared(f"a million samples, {form}", path, DESERIALIZED, {REPLAY: 1.6}, rounds)
        for form in FORMATS:
            path = _write(folder / f"images{form}", form, TOPICS, SAMPLES * 3 // 10, 10_000_000, IMAGE_BYTES)
            # SQLite reads past images at no cost, so a replay costs as much as without images.
            required = {READ: 1.3, REPLAY: None if form == "sqlite3" else 1.3}
            yield from _compared(f"95 % images, {form}", path, RAW, required, rounds)
        topics = [f"/signal{number}" for number in range(10)]
        path = _write(folder / "day", "MCAP", topics, DAY_S * 100, 10_000_000)
        signal = {"warn_above": 56.5, "stale_after_s": 5.0}
        write_yaml(folder, thresholds=alert_system({topic[1:]: signal for topic in topics}))
        used_s, memory_mb = _run(REPLAY, path, "--thresholds", str(folder / "thresholds.yaml"))
        what = "a day, ten signals at 10 Hz, MCAP"
        yield within(what, REPLAY, used_s, 120.0, "s")
        yield _memory(what, REPLAY, memory_mb)


def _run(contestant: str, path: Path, *arguments: str) -> list[float]:
    """Returns the CPU time in s and the memory in MB of one contestant."""
    command = [sys.executable, "-m", "benchmarks.recordings", contestant, str(path), *arguments]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False)
    last = done.stderr.strip().splitlines()[-1]
    if done.returncode:
        raise RuntimeError(last)
    return list(json.loads(last))


def _write(path: Path, form: str, topics: Sequence[str], count: int, period_ns: int, image_bytes: int = 0) -> Path:
    """Writes Float32 samples in turn, and after every hundred an image if `image_bytes` is set."""
    store: Any = get_typestore(Stores.ROS1_NOETIC if form == ".bag" else Stores.ROS2_JAZZY)
    if form == ".bag":
        writer: Any = rosbag1.Writer(path)
    else:
        writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[form.upper()])
    serialize = store.serialize_ros1 if form == ".bag" else store.serialize_cdr
    payloads = [bytes(serialize(store.types[FLOAT32](50.0 + value), FLOAT32)) for value in range(7)]
    with writer:
        connections = [writer.add_connection(topic, FLOAT32, typestore=store) for topic in topics]
        images = writer.add_connection("/image", "std_msgs/msg/UInt8MultiArray", typestore=store)
        blob = bytes(image_bytes)  # no valid message: nothing decodes it
        for index in range(count):
            time_ns = 1_700_000_000_000_000_000 + index * period_ns
            writer.write(connections[index % len(connections)], time_ns, payloads[index % 7])
            if image_bytes and index % 100 == 0:
                writer.write(images, time_ns, blob)
    return path


def _compared(what: str, path: Path, peer: str, required: Mapping[str, Any], rounds: int) -> Iterator[Row]:
    """Yields the rows of a peer and of what is compared with it."""
    measured = [{name: _run(name, path) for name in (peer, *required)} for _ in range(rounds)]
    used_s = {name: [each[name][0] for each in measured] for name in (peer, *required)}
    for row in beside(what, used_s, "s", digits=2):
        yield row._replace(required=required.get(row.contestant))
        if row.contestant != peer:
            yield _memory(what, row.contestant, max(each[row.contestant][1] for each in measured))


def _memory(what: str, contestant: str, memory_mb: float) -> Row:
    return within(f"{what}, memory", contestant, memory_mb, 120.0, "MB")


def _play(contestant: str, path: str, *arguments: str) -> None:
    """Does what one contestant does."""
    if contestant == REPLAY:
        sys.argv = ["robot-health", "replay", path, "--fail-on", "never", "--json", *arguments]
        try:
            code: object = main()
        except SystemExit as end:
            code = end.code
        assert not code, code
    elif contestant == READ:
        with Recordings([path]) as recordings:
            wanted = [each for each in recordings.channels if each.type_name == "std_msgs/Float32"]
            for _ in recordings.messages(dict.fromkeys(wanted)):
                pass
    else:
        with AnyReader([Path(path)]) as reader:
            connections = [each for each in reader.connections if each.msgtype == FLOAT32]
            for connection, _, data in reader.messages(connections=connections):
                if contestant == DESERIALIZED:
                    reader.deserialize(data, connection.msgtype)


if __name__ == "__main__":
    began_s = time.process_time()
    _play(*sys.argv[1:])
    used_s, status = time.process_time() - began_s, Path("/proc/self/status").read_text("ascii").splitlines()
    memory = next(line for line in status if line.startswith("VmHWM"))  # ru_maxrss includes that of the parent
    print(json.dumps([used_s, int(memory.split()[1]) / 1024]), file=sys.stderr)
