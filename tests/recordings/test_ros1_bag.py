"""ROS 1 bags, written by rosbags: packed or not, with and without an index, cut off anywhere."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from harness.recorded import read, values, write_bag

from robot_health_monitor.recordings.recording import RecordingError
from robot_health_monitor.recordings.ros1_bag import Ros1Bag

MESSAGES = sorted([*values("/battery_level", range(50)), *values("/temperature", range(50), start_s=0.25)])
MAGIC = b"#ROSBAG V2.0\n"


def record_starts(data: bytes) -> list[tuple[int, int]]:
    """Returns place and type of each record of a bag."""
    found, position = [], len(MAGIC)
    while position < len(data):
        length = struct.unpack_from("<I", data, position)[0]
        header = data[position + 4 : position + 4 + length]
        found.append((position, header[header.index(b"op=") + 3]))
        position += 4 + length
        position += 4 + struct.unpack_from("<I", data, position)[0]
    return found


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_all_messages_are_read(tmp_path: Path, compression: str) -> None:
    found = read(write_bag(tmp_path / "a.bag", MESSAGES, compression, chunk_size=1000))
    assert found.messages == MESSAGES
    assert found.problems == []


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_bag_without_an_index_is_read_to_its_end(tmp_path: Path, compression: str) -> None:
    path = Path(write_bag(tmp_path / "a.bag", MESSAGES, compression, chunk_size=1000))
    data = path.read_bytes()
    chunks_end = next(start for start, op in record_starts(data) if op == 7)
    active = tmp_path / "a.bag.active"
    place = data.index(b"index_pos=") + len(b"index_pos=")
    active.write_bytes(data[:place] + bytes(8) + data[place + 8 : chunks_end])
    found = read(str(active))
    assert found.messages == MESSAGES
    assert found.problems == [f"{active}: has no index (the recorder was stopped early): read to its end"]


def test_the_unfinished_chunk_of_a_recorder_that_was_killed_is_read(tmp_path: Path) -> None:
    """rosbag writes the size of a chunk when it is full: until then it says 0, and the messages follow."""
    path = Path(write_bag(tmp_path / "a.bag", MESSAGES, chunk_size=1 << 20))
    data = bytearray(path.read_bytes())
    (chunk,) = [start for start, op in record_starts(data) if op == 5]
    header = struct.unpack_from("<I", data, chunk)[0]
    struct.pack_into("<I", data, chunk + 4 + header, 0)
    place = data.index(b"size=", chunk) + 5
    struct.pack_into("<I", data, place, 0)
    active = tmp_path / "a.bag.active"
    active.write_bytes(data)
    assert read(str(active)).messages == MESSAGES


def test_messages_are_read_in_the_order_of_their_times(tmp_path: Path) -> None:
    found = read(write_bag(tmp_path / "a.bag", reversed(MESSAGES)))
    assert found.messages == MESSAGES


def test_an_empty_bag_has_no_messages(tmp_path: Path) -> None:
    bag = Ros1Bag(write_bag(tmp_path / "a.bag", []))
    assert (bag.channels, bag.span_ns, list(bag.messages({}))) == ([], None, [])


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_bag_that_is_cut_off_anywhere_is_read_as_far_as_possible(tmp_path: Path, compression: str) -> None:
    data = Path(write_bag(tmp_path / "a.bag", MESSAGES, compression, chunk_size=1000)).read_bytes()
    cut = tmp_path / "cut.bag"
    longest = 0
    for size in range(len(MAGIC), len(data), 97):
        cut.write_bytes(data[:size])
        found = read(str(cut))
        assert found.messages == MESSAGES[: len(found.messages)]
        assert len(found.problems) == 1
        assert len(found.messages) >= longest
        longest = len(found.messages)
    assert longest == len(MESSAGES)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        (b"compression=none", b"compression=brot", "compression 'brot', expected none, bz2, lz4 or zstd"),
        (b"op=\x05", b"op=\x05"[:3] + b"\x63", ""),
    ],
)
def test_a_damaged_chunk_is_left_out_with_a_message(tmp_path: Path, old: bytes, new: bytes, problem: str) -> None:
    path = Path(write_bag(tmp_path / "a.bag", MESSAGES, chunk_size=1000))
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    found = read(str(path))
    assert 0 < len(found.messages) < len(MESSAGES)
    if problem:
        assert problem in found.problems[0]
        assert found.problems[0].endswith("a part of it is left out")


def test_zeros_after_the_header_end_the_reading_at_once(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    with open(path, "wb") as file:
        file.write(MAGIC)
        file.truncate(1 << 33)
    found = read(str(path))
    assert found.messages == []
    assert found.problems == [f"{path}: damaged at byte 13 of 8589934592 (a record without a type): read up to there"]


@pytest.mark.parametrize("content", [b"", b"#ROSBAG V1.2\n", b"\0" * 100])
def test_another_file_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(content)
    with pytest.raises(RecordingError) as raised:
        Ros1Bag(str(path))
    assert str(raised.value) == f"{path}: expected a ROS 1 bag, which starts with #ROSBAG V2.0"


def test_only_the_channels_that_are_asked_for_are_read(tmp_path: Path) -> None:
    bag = Ros1Bag(write_bag(tmp_path / "a.bag", MESSAGES))
    (wanted,) = [channel for channel in bag.channels if channel.topic == "/temperature"]
    assert {target for _, target, _ in bag.messages({wanted: "yes"})} == {"yes"}
    assert len(list(bag.messages({wanted: "yes"}))) == 50


def test_the_real_recorder_of_ros1_writes_what_is_read(tmp_path: Path) -> None:
    rosbag = pytest.importorskip("rosbag", reason="needs ROS 1's rosbag: runs in the session ros1")
    genpy = pytest.importorskip("genpy")
    from std_msgs.msg import Float32

    for compression in ("none", "bz2", "lz4"):
        path = tmp_path / f"{compression}.bag"
        with rosbag.Bag(str(path), "w", compression=compression, chunk_threshold=500) as bag:
            for index in range(30):
                bag.write("/battery_level", Float32(index), genpy.Time(1_700_000_000 + index))
        assert read(str(path)).messages == list(values("/battery_level", range(30)))
