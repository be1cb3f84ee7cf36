"""CPU time and memory of a replay, compared with rosbags reading the same recordings.

Every contestant runs in a separate process, one after the other (`python -m benchmarks.recordings CONTESTANT FILE`),
which imports the libraries of all. A replay includes judging.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Iterator, Mapping, Sequence

from rosbags import rosbag1, rosbag2
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from benchmarks.processes import alert_system, reported, run_python, write_yaml
from benchmarks.table import Row, beside, side_by_side, within
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
        used_s, used_bytes = _run(REPLAY, path, "--thresholds", folder / "thresholds.yaml")
        what = "a day, ten signals at 10 Hz, MCAP"
        yield within(what, REPLAY, used_s, 120.0, "s")
        yield within(f"{what}, memory", REPLAY, used_bytes, 120.0, "MB")


def _run(contestant: str, *arguments: object) -> list[float]:
    """Returns the CPU time in s and the memory in bytes of one contestant."""
    return list(json.loads(run_python("-m", "benchmarks.recordings", contestant, *arguments)))


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
    most_bytes = dict.fromkeys((peer, *required), 0.0)

    def measure() -> dict[str, float]:
        used = {name: _run(name, path) for name in most_bytes}
        most_bytes.update({name: max(most_bytes[name], each[1]) for name, each in used.items()})
        return {name: each[0] for name, each in used.items()}

    for row in beside(what, side_by_side(measure, rounds), "s", required):
        yield row
        if row.contestant != peer:
            yield within(f"{what}, memory", row.contestant, most_bytes[row.contestant], 120.0, "MB")


def _play(contestant: str, path: str, *arguments: str) -> None:
    """Does what one contestant does."""
    if contestant == REPLAY:
        code = main(["replay", path, "--fail-on", "never", "--json", *arguments])
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
    with reported(time.process_time):
        _play(*sys.argv[1:])
