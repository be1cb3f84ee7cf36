"""The MCAP file, read by the readers of the library mcap; files that a killed process left."""

from __future__ import annotations

import os
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap")

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk

from robot_health_monitor.core.messages.raw_messages import RawFormat
from robot_health_monitor.ops.black_box.recording_file import PART, RecordingFile, complete
from robot_health_monitor.ops.black_box.ring import Message

FLOAT = RawFormat("ros1", "std_msgs/Float32", "ros1msg", "float32 data\n")
TEXT = RawFormat("json", "std_msgs/String", "jsonschema", '{"type":"object"}')
ATTACHMENTS = {"thresholds.yaml": "a: 1\n", "state.json": "{}"}


def messages(number: int, size: int = 10) -> list[Message]:
    channels = (("/a", FLOAT), ("/b", FLOAT), ("/a", TEXT))
    return [(float(place), *channels[place % 3], bytes([place % 256]) * size) for place in range(number)]


def content(path: Path) -> list[tuple[str, int, bytes]]:
    with path.open("rb") as stream:
        reader = make_reader(stream)
        return [(channel.topic, message.log_time, message.data) for _, channel, message in reader.iter_messages()]


def test_a_complete_file_has_everything(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    file = RecordingFile(str(path), "ros1", 5_000_000_000, ATTACHMENTS)
    assert not path.exists()
    file.write(messages(4), 100.0)
    file.finish({"robot": "r1"})
    assert sorted(os.listdir(tmp_path)) == ["a.mcap"]
    assert content(path) == [
        ("/a", 100_000_000_000, bytes(10)),
        ("/b", 101_000_000_000, b"\1" * 10),
        ("/a", 102_000_000_000, b"\2" * 10),
        ("/a", 103_000_000_000, b"\3" * 10),
    ]
    with path.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros1"
        attachments: Any = list(reader.iter_attachments())
        assert [(each.name, each.media_type, each.log_time, each.data) for each in attachments] == [
            ("thresholds.yaml", "application/yaml", 5_000_000_000, b"a: 1\n"),
            ("state.json", "application/json", 5_000_000_000, b"{}"),
        ]
        summary = reader.get_summary()
        schemas = {(schema.name, schema.encoding, schema.data) for schema in summary.schemas.values()}
        assert schemas == {
            ("std_msgs/Float32", "ros1msg", b"float32 data\n"),
            ("std_msgs/String", "jsonschema", b'{"type":"object"}'),
        }
        assert sorted((each.topic, each.message_encoding) for each in summary.channels.values()) == [
            ("/a", "json"), ("/a", "ros1"), ("/b", "ros1"),
        ]  # fmt: skip


def test_a_discarded_file_is_removed(tmp_path: Path) -> None:
    file = RecordingFile(str(tmp_path / "a.mcap"), "", 0, ATTACHMENTS)
    file.write(messages(3), 0.0)
    file.discard()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("place", range(0, 100, 7))
def test_a_file_that_was_cut_anywhere_is_completed_or_removed(tmp_path: Path, place: int) -> None:
    path = tmp_path / "a.mcap"
    file = RecordingFile(str(path), "ros1", 0, ATTACHMENTS)
    sent = messages(40, 30_000)  # 1.2 MB: several chunks
    file.write(sent, 0.0)
    file.finish({})
    data = path.read_bytes()
    path.unlink()
    part = tmp_path / f"a.mcap{PART}"
    part.write_bytes(data[: len(data) * place // 100])
    is_kept = complete(str(path))
    assert sorted(os.listdir(tmp_path)) == (["a.mcap"] if is_kept else [])
    if is_kept:
        found = content(path)
        assert found
        assert [data for _, _, data in found] == [data for *_, data in sent[: len(found)]]
        with path.open("rb") as stream:
            attachments = list(make_reader(stream).iter_attachments())
        assert [each.name for each in attachments] == ["thresholds.yaml", "state.json"]


@pytest.mark.parametrize("data", [b"", b"x", bytes(1000), b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + b"\x06" + b"\xff" * 40])
def test_a_file_of_other_bytes_is_removed(tmp_path: Path, data: bytes) -> None:
    (tmp_path / f"a.mcap{PART}").write_bytes(data)
    assert not complete(str(tmp_path / "a.mcap"))
    assert os.listdir(tmp_path) == []


def test_a_completion_that_was_itself_killed_is_completed(tmp_path: Path) -> None:
    path, part = tmp_path / "a.mcap", tmp_path / f"a.mcap{PART}"
    file = RecordingFile(str(path), "ros1", 0, ATTACHMENTS)
    file.write(messages(20, 30_000), 0.0)  # two chunks, and a rest that is lost
    part_data = part.read_bytes()
    file.discard()
    part.write_bytes(part_data)
    assert complete(str(path))
    whole = path.read_bytes()
    begun = whole.index(b"\x0f\x04" + bytes(11))  # the record DataEnd
    for cut in range(begun, len(whole)):
        part.write_bytes(whole[:cut])
        assert complete(str(path))
        assert path.read_bytes() == whole


def test_a_chunk_that_unpacks_to_very_much_takes_no_memory(tmp_path: Path) -> None:
    """256 MiB of zeros in a few kilobytes."""
    path, part = tmp_path / "a.mcap", tmp_path / f"a.mcap{PART}"
    file = RecordingFile(str(path), "ros1", 0, ATTACHMENTS)
    file.write(messages(20, 30_000), 0.0)
    data = part.read_bytes()
    file.discard()
    bomb = RecordBuilder()
    packed = zstandard.ZstdCompressor().compress(bytes(1 << 28))
    Chunk("zstd", packed, 0, 0, 0, 1 << 28).write(bomb)
    part.write_bytes(data + bomb.end())
    tracemalloc.start()
    try:
        assert complete(str(path))
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 2_000_000
