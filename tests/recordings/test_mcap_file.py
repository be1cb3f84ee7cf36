"""MCAP files, written by the library mcap: profiles, compressions, with and without a summary, cut off anywhere."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from harness.recorded import Recorded, read, values, write_mcap

from robot_health_monitor.recordings.mcap_file import McapFile
from robot_health_monitor.recordings.recording import RecordingError

MESSAGES = sorted([*values("/battery_level", range(50)), *values("/temperature", range(50), start_s=0.25)])
BARE = {
    "use_statistics": False,
    "use_summary_offsets": False,
    "repeat_channels": False,
    "repeat_schemas": False,
}
MAGIC = b"\x89MCAP0\r\n"


@pytest.mark.parametrize("options", [{}, BARE, {"use_chunking": False}, {"use_chunking": False, **BARE}], ids=str)
@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_all_messages_are_read(tmp_path: Path, encoding: str, compression: str, options: dict) -> None:  # type: ignore[type-arg]
    path = write_mcap(
        tmp_path / "a.mcap", MESSAGES, encoding=encoding, compression=compression, chunk_size=500, **options
    )
    found = read(path)
    assert found.messages == MESSAGES
    assert found.problems == []
    assert {channel.raw_format.message_encoding for channel in found.channels} == {encoding}


def test_an_index_of_messages_is_not_needed(tmp_path: Path) -> None:
    from mcap.writer import IndexType

    path = write_mcap(tmp_path / "a.mcap", MESSAGES, chunk_size=500, index_types=IndexType.NONE)
    assert read(path).messages == MESSAGES


def test_messages_are_read_in_the_order_of_their_times(tmp_path: Path) -> None:
    assert read(write_mcap(tmp_path / "a.mcap", reversed(MESSAGES))).messages == MESSAGES


def test_an_empty_file_has_no_messages(tmp_path: Path) -> None:
    file = McapFile(write_mcap(tmp_path / "a.mcap", []))
    assert (file.channels, file.span_ns, file.problem, list(file.messages({}))) == ([], None, "", [])


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_a_file_that_is_cut_off_anywhere_is_read_as_far_as_possible(tmp_path: Path, compression: str) -> None:
    data = Path(write_mcap(tmp_path / "a.mcap", MESSAGES, compression=compression, chunk_size=500)).read_bytes()
    cut = tmp_path / "cut.mcap"
    longest = 0
    for size in range(len(MAGIC), len(data), 61):
        cut.write_bytes(data[:size])
        found = read(str(cut))
        assert found.messages == MESSAGES[: len(found.messages)]
        assert len(found.problems) == 1, size
        assert len(found.messages) >= longest
        longest = len(found.messages)
    assert longest == len(MESSAGES)


def test_a_value_that_was_changed_in_the_file_is_found_by_the_checksum(tmp_path: Path) -> None:
    path = Path(write_mcap(tmp_path / "a.mcap", values("/x", [1234.5] * 100), chunk_size=1000))
    data = path.read_bytes()
    place = data.index(b"\x00\x50\x9a\x44")
    path.write_bytes(data[:place] + b"\x00\x50\x9a\xc4" + data[place + 4 :])
    found = read(str(path))
    assert 0 < len(found.messages) < 100
    assert {message.message for message in found.messages} == {1234.5}
    assert "a chunk with a wrong checksum" in found.problems[0]
    assert found.problems[0].endswith("a part of it is left out")


def test_zeros_after_the_magic_end_the_reading_at_once(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with open(path, "wb") as file:
        file.write(MAGIC)
        file.truncate(1 << 33)
    found = read(str(path))
    assert found.messages == []
    assert found.problems == [f"{path}: damaged at byte 8 of 8589934592 (a record of type 0): read up to there"]


def test_an_unknown_compression_is_one_line(tmp_path: Path) -> None:
    path = Path(write_mcap(tmp_path / "a.mcap", MESSAGES, compression="zstd"))
    path.write_bytes(path.read_bytes().replace(b"\x04\0\0\0zstd", b"\x04\0\0\0brot"))
    found = read(str(path))
    assert found.messages == []
    assert len(found.problems) == 1
    assert "compression 'brot', expected none, bz2, lz4 or zstd" in found.problems[0]


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"\0" * 100])
def test_another_file_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError) as raised:
        McapFile(str(path))
    assert str(raised.value) == f"{path}: expected an MCAP file, which starts with 89 4D 43 41 50"


def test_a_recording_without_definitions_uses_the_standard_types(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", MESSAGES, definitions={"std_msgs/msg/Float32": ("ros2msg", "")})
    assert read(path).messages == MESSAGES


def test_idl_definitions_are_used(tmp_path: Path) -> None:
    idl = (
        "=" * 80 + "\nIDL: std_msgs/msg/Float32\nmodule std_msgs { module msg { struct Float32 { float data; }; }; };\n"
    )
    path = write_mcap(tmp_path / "a.mcap", MESSAGES, definitions={"std_msgs/msg/Float32": ("ros2idl", idl)})
    assert read(path).messages == MESSAGES


def test_only_chunks_with_wanted_messages_are_unpacked(tmp_path: Path) -> None:
    messages = [*values("/x", range(100)), *values("/y", range(100), start_s=200.0), Recorded(400.0, "/x", 1.0)]
    file = McapFile(write_mcap(tmp_path / "a.mcap", messages, compression="zstd", chunk_size=500))
    (wanted,) = [channel for channel in file.channels if channel.topic == "/y"]
    assert len(list(file.messages({wanted: "y"}))) == 100


@pytest.mark.parametrize(("offset", "length"), [(9, 2**64 - 1), (17, 0), (17, 8), (17, 2**40)])
def test_an_attachment_of_an_impossible_place_or_size_is_not_read(tmp_path: Path, offset: int, length: int) -> None:
    """A size below that of a record's prefix would read all that follows, of a file of any size."""
    from mcap.opcode import Opcode
    from mcap.writer import Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, enable_crcs=False)
        writer.start()
        writer.add_attachment(0, 0, "thresholds.yaml", "text/yaml", b"signals: {}")
        writer.finish()
    assert McapFile(str(path)).attachments["thresholds.yaml"] == "signals: {}"
    data = bytearray(path.read_bytes())
    # The name follows the prefix (9 bytes), four numbers of 8 bytes, the size of the data and its own (8 and 4).
    index = data.rindex(b"thresholds.yaml") - 4 - 5 * 8 - 9
    assert data[index] == Opcode.ATTACHMENT_INDEX
    struct.pack_into("<Q", data, index + offset, length)
    path.write_bytes(data)
    file = McapFile(str(path))
    assert (file.attachments, file.problem) == ({}, f"{path}: its summary is damaged: read to its end")
