"""Recordings of every format, one or several, as one stream; and everything that can be wrong with them."""

from __future__ import annotations

import random
import re
import shutil
import time
from pathlib import Path
from typing import Any

import pytest
import zstandard
from harness.recorded import Recorded, read, values, write_bag, write_folder, write_mcap
from rosbags import rosbag2

from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.recordings import reading
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings
from robot_health_monitor.recordings.recording import RecordingError

MESSAGES = sorted([*values("/battery_level", range(50)), *values("/temperature", range(50), start_s=0.25)])
STORAGES = ["sqlite3", "mcap"] if hasattr(rosbag2, "StoragePlugin") else ["sqlite3"]


def metadata(folder: str, old: str, new: str) -> None:
    """Edits metadata.yaml."""
    file = Path(folder) / "metadata.yaml"
    text, count = re.subn(old, new, file.read_text())
    assert count
    file.write_text(text)


@pytest.mark.parametrize("version", range(1, 10))
@pytest.mark.parametrize("storage", STORAGES)
def test_folders_of_every_version_are_read(tmp_path: Path, storage: str, version: int) -> None:
    """rosbags writes 8 and 9; older ones have fewer entries."""
    folder = write_folder(tmp_path / "bag", MESSAGES, storage=storage)
    metadata(folder, r"version: \d", f"version: {version}")
    if version < 5:
        metadata(folder, r"(?m)^  (files|ros_distro|custom_data):.*\n(    .*\n|  - .*\n)*", "")
    if version < 4:
        metadata(folder, r"offered_qos_profiles: .*", "offered_qos_profiles: ''")
    if version < 3:
        metadata(folder, r"(?m)^  compression_.*\n", "")
    found = read(folder)
    assert found.messages == MESSAGES
    assert found.problems == []


@pytest.mark.parametrize("compression", ["file", "message"])
@pytest.mark.parametrize("storage", STORAGES)
def test_compressed_folders_are_read(tmp_path: Path, storage: str, compression: str) -> None:
    if (storage, compression) == ("mcap", "file") and not hasattr(rosbag2, "StoragePlugin"):
        pytest.skip("this rosbags cannot write it")
    found = read(write_folder(tmp_path / "bag", MESSAGES, storage=storage, compression=compression))
    assert found.messages == MESSAGES
    assert found.problems == []


@pytest.mark.parametrize("storage", STORAGES)
def test_packed_messages_are_unpacked_without_metadata_too(tmp_path: Path, storage: str) -> None:
    folder = Path(write_folder(tmp_path / "bag", MESSAGES, storage=storage, compression="message"))
    (folder / "metadata.yaml").unlink()
    (file,) = folder.iterdir()
    assert read(str(folder)).messages == MESSAGES
    assert read(str(file)).messages == MESSAGES


def split(tmp_path: Path) -> Path:
    """Returns a folder of two files."""
    folder = tmp_path / "bag"
    folder.mkdir()
    lines = ["rosbag2_bagfile_information:", "  version: 5", "  storage_identifier: mcap", "  relative_file_paths:"]
    for index, part in enumerate((MESSAGES[:60], MESSAGES[60:])):
        name = f"bag_{index}.mcap"
        write_mcap(folder / name, part)
        lines.append(f"    - {name}")
    (folder / "metadata.yaml").write_text("\n".join(lines))
    return folder


def test_split_recordings_are_read_as_one(tmp_path: Path) -> None:
    assert read(str(split(tmp_path))).messages == MESSAGES


def test_a_missing_split_is_named_and_the_others_are_read(tmp_path: Path) -> None:
    folder = split(tmp_path)
    (folder / "bag_0.mcap").unlink()
    found = read(str(folder))
    assert found.messages == MESSAGES[60:]
    assert found.problems == [f"{folder}/bag_0.mcap: cannot be found: left out"]


@pytest.mark.parametrize("text", [None, "", "[", "rosbag2_bagfile_information: 3", "a: &a [*a]", "\0", "\xff"])
def test_a_folder_without_usable_metadata_is_read_completely(tmp_path: Path, text: Any) -> None:
    folder = split(tmp_path)
    (folder / "metadata.yaml").unlink()
    if text is not None:
        (folder / "metadata.yaml").write_bytes(text.encode("latin-1"))
    found = read(str(folder))
    assert found.messages == MESSAGES
    assert len(found.problems) == 1
    assert found.problems[0].startswith(f"{folder}/metadata.yaml: ")


def test_several_recordings_are_read_in_the_order_of_their_times(tmp_path: Path) -> None:
    """They may overlap, and be of different formats."""
    parts = [MESSAGES[0::3], MESSAGES[1::3], MESSAGES[2::3]]
    paths = [
        write_bag(tmp_path / "a.bag", parts[0]),
        write_mcap(tmp_path / "b.mcap", parts[1]),
        write_folder(tmp_path / "c", parts[2]),
    ]
    assert read(*paths).messages == MESSAGES


def test_the_time_span_is_that_of_all_files(tmp_path: Path) -> None:
    paths = [
        write_bag(tmp_path / "a.bag", values("/x", [1], start_s=5.0)),
        write_bag(tmp_path / "b.bag", values("/x", [1, 2])),
    ]
    with Recordings(paths) as recordings:
        first, last = recordings.span_ns or (0, 0)
    assert last - first == 5_000_000_000


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("missing.bag", "no such file"),
        ("text.txt", "expected a .bag file"),
        ("empty_folder", "has no .mcap or .db3 file"),
        ("folder.bag", "has no .mcap or .db3 file"),
        ("empty.bag", "expected a ROS 1 bag"),
        ("empty.mcap", "expected an MCAP file"),
        ("empty.db3", "expected an SQLite file"),
        ("empty.mcap.zstd", "expected an MCAP file"),
        ("text.db3.zstd", "expected an SQLite file"),
    ],
)
def test_what_is_no_recording_is_refused_in_one_line(tmp_path: Path, name: str, problem: str) -> None:
    for folder in ("empty_folder", "folder.bag"):
        (tmp_path / folder).mkdir()
    for file in ("text.txt", "text.db3.zstd"):
        (tmp_path / file).write_text("text")
    for file in ("empty.bag", "empty.mcap", "empty.db3", "empty.mcap.zstd"):
        (tmp_path / file).touch()
    with pytest.raises(RecordingError) as raised:
        Recordings([str(tmp_path / name)])
    assert problem in str(raised.value)
    assert str(raised.value).startswith(f"{tmp_path / name}: ")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3", "folder"])
def test_a_recording_without_permission_is_refused_in_one_line(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Root may read everything, so the refusal of the system is simulated."""
    path = tmp_path / name
    path.mkdir() if name == "folder" else path.touch()

    def refuse(*arguments: Any, **options: Any) -> Any:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("builtins.open", refuse)
    monkeypatch.setattr(reading.os, "listdir", refuse)
    with pytest.raises(RecordingError, match="cannot be read: Permission denied"):
        Recordings([str(path)])


def test_a_packed_file_that_is_cut_off_is_read_as_far_as_possible(tmp_path: Path) -> None:
    plain = Path(write_mcap(tmp_path / "a.mcap", values("/x", range(5000)), chunk_size=500))
    packed = tmp_path / "b.mcap.zstd"
    data = zstandard.ZstdCompressor(level=1).compress(plain.read_bytes())
    packed.write_bytes(data)
    assert len(read(str(packed)).messages) == 5000
    packed.write_bytes(data[: len(data) * 9 // 10])
    found = read(str(packed))
    assert found.messages == list(values("/x", range(len(found.messages))))
    assert found.problems
    assert all(problem.startswith(f"{packed}: ") for problem in found.problems)


def test_a_packed_bomb_is_unpacked_to_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "_LARGEST_UNPACKED", 3_000_000)
    bomb = tmp_path / "bomb.mcap.zstd"
    bomb.write_bytes(zstandard.ZstdCompressor().compress(b"\x89MCAP0\r\n" + bytes(500_000_000)))
    found = read(str(bomb))
    assert found.messages == []
    assert found.problems[0] == f"{bomb}: unpacks to an implausible size: read only its beginning"


def test_unpacked_files_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading.tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    packed = tmp_path / "b.mcap.zstd"
    packed.write_bytes(
        zstandard.ZstdCompressor().compress(Path(write_mcap(tmp_path / "a.mcap", MESSAGES)).read_bytes())
    )
    with Recordings([str(packed)]):
        assert list((tmp_path / "temporary").iterdir()) != []
    assert list((tmp_path / "temporary").iterdir()) == []


def recorded_in(folder: Path) -> list[Path]:
    """Returns a recording of each format."""
    messages = sorted([*values("/battery_level", range(200)), *values("/temperature", range(200), start_s=0.25)])
    found = [
        Path(write_bag(folder / f"{compression}.bag", messages, compression, chunk_size=2000))
        for compression in ("none", "bz2", "lz4")
    ]
    found += [
        Path(write_mcap(folder / f"{compression}.mcap", messages, compression=compression, chunk_size=2000))
        for compression in ("none", "lz4", "zstd")
    ]
    (database,) = Path(write_folder(folder / "bag", messages)).glob("*.db3")
    return [*found, database]


@pytest.mark.parametrize("kind", range(7), ids=lambda kind: f"format{kind}")
def test_damage_is_one_line_or_a_good_result(tmp_path: Path, kind: int) -> None:
    """Bits, blocks of zeros, removed and repeated parts, at random places; the same in each run."""
    original = recorded_in(tmp_path)[kind]
    data = original.read_bytes()
    chance = random.Random(kind)
    for attempt in range(60):
        damaged = tmp_path / f"damaged{original.suffix}"
        damaged.write_bytes(damage(chance, data))
        started_s = time.monotonic()
        try:
            with Recordings([str(damaged)]) as recordings:
                player = Player(recordings)
                node = player.node("node", {})
                for channel in recordings.channels:
                    if channel.type_name == "std_msgs/Float32":
                        node.subscribe(channel.topic, "std_msgs/Float32", lambda value, now_s: None, field="data")
                player.play()
                lines = player.problems
        except (RecordingError, ConfigError) as error:
            lines = [str(error)]
        assert all("\n" not in line for line in lines), attempt
        assert time.monotonic() - started_s < 30, attempt  # a hang, not a measurement


def damage(chance: random.Random, data: bytes) -> bytes:
    """Returns the bytes with one to three damages."""
    damaged = bytearray(data)
    for _ in range(chance.randint(1, 3)):
        place = chance.randrange(len(damaged)) if chance.random() < 0.7 else chance.randrange(min(600, len(damaged)))
        length = chance.choice((1, 8, 64, 4096))
        kind = chance.randrange(5)
        if kind == 0:
            damaged[place] ^= 1 << chance.randrange(8)
        elif kind == 1:
            damaged[place : place + length] = bytes(len(damaged[place : place + length]))
        elif kind == 2 and len(damaged) > length + 1:
            del damaged[place : place + length]
        elif kind == 3:
            damaged[place:place] = damaged[place : place + length]
        else:
            damaged[place : place + 4] = b"\xff\xff\xff\xff"[: len(damaged[place : place + 4])]
        if not damaged:
            break
    return bytes(damaged)


def test_messages_out_of_order_are_played_late_with_a_message(tmp_path: Path) -> None:
    messages = [*values("/x", range(100), start_s=100.0), *values("/x", range(100, 200))]
    path = write_mcap(tmp_path / "a.mcap", [*messages, *values("/x", [0.0], start_s=50.5)], chunk_size=300)
    player = Player(Recordings([path]))
    heard: list[float] = []
    player.node("node", {}).subscribe("x", "std_msgs/Float32", lambda value, now_s: heard.append(value), field="data")
    player.play()
    assert len(heard) == 201
    assert len(player.problems) == 1
    assert player.problems[0].endswith("messages out of order, judged late")


def test_folders_that_were_moved_are_read(tmp_path: Path) -> None:
    """Old metadata has the folder's name in its paths."""
    folder = split(tmp_path)
    metadata(str(folder), "- bag_", "- old_name/bag_")
    shutil.move(str(folder), str(tmp_path / "new_name"))
    assert read(str(tmp_path / "new_name")).messages == MESSAGES


def test_one_message_without_a_period_is_read(tmp_path: Path) -> None:
    assert read(write_bag(tmp_path / "a.bag", [Recorded(0.0, "/x", 1.0)])).messages == [Recorded(0.0, "/x", 1.0)]
