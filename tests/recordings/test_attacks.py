"""Small recordings that would take hours or all memory: each is refused or read with one line, by a limited process."""

from __future__ import annotations

import bz2
import json
import os
import shutil
import sqlite3
import struct
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Callable

import lz4.frame
import pytest
import zstandard
from harness.recorded import START_NS, values, write_bag, write_folder, write_mcap

MEMORY_KB = 512 * 1024
SECONDS = 120
"""Far more than it takes: a hang, not a measurement."""
MESSAGES = values("/battery", [50.0] * 100)
THRESHOLDS = "alert_system: {ros__parameters: {signals: {battery: {warn_below: 20.0}}}}\n"


def database(folder: Path, *statements: str) -> str:
    """Returns a .db3 file that some statements changed."""
    path = next(Path(write_folder(folder / "bag", MESSAGES)).glob("*.db3"))
    with closing(sqlite3.connect(path)) as connection:
        for statement in statements:
            connection.execute(statement)
        connection.commit()
    return str(path)


def endless_view(folder: Path) -> str:
    return database(
        folder,
        "ALTER TABLE messages RENAME TO stored",
        f"CREATE VIEW messages AS WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) "
        f"SELECT n AS id, 1 AS topic_id, {START_NS} + n AS timestamp, x'00010000' AS data FROM c",
    )


def generated_blobs(folder: Path) -> str:
    if sqlite3.sqlite_version_info < (3, 31):
        pytest.skip("SQLite has no generated columns")
    return database(
        folder,
        "DROP TABLE messages",
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "data BLOB GENERATED ALWAYS AS (zeroblob(1000000000)))",
        f"INSERT INTO messages(topic_id, timestamp) VALUES(1, {START_NS})",
    )


def page_that_is_its_own_child(folder: Path) -> str:
    """The pages of `messages` form a tree in which every page has the next one many times."""
    path = database(folder, "INSERT INTO messages SELECT id + 1000, topic_id, timestamp, zeroblob(500) FROM messages")
    with closing(sqlite3.connect(path)) as connection:
        (root,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
        (page_size,) = connection.execute("PRAGMA page_size").fetchone()
    data = bytearray(Path(path).read_bytes())
    start = (root - 1) * page_size
    assert data[start] == 5, "an interior page"
    (cells,) = struct.unpack_from(">H", data, start + 3)
    pages = len(data) // page_size
    levels: list[int] = [root]
    for level in range(12):  # copies of the root, each pointing to the next copy only
        levels.append(pages + level + 1)
        data += data[start : start + page_size]
    last = struct.unpack_from(">I", data, start + 8)[0]
    for page, child in zip(levels, [*levels[1:], last]):
        at = (page - 1) * page_size
        struct.pack_into(">I", data, at + 8, child)
        for cell in range(cells):
            (place,) = struct.unpack_from(">H", data, at + 12 + 2 * cell)
            struct.pack_into(">I", data, at + place, child)
    struct.pack_into(">I", data, 28, len(data) // page_size)
    Path(path).write_bytes(bytes(data))
    return path


def large_blobs(folder: Path) -> str:
    return database(
        folder,
        *[
            f"INSERT INTO messages(id, topic_id, timestamp, data) VALUES({n}, 1, {START_NS + n}, zeroblob(300000000))"
            for n in (1000, 1001, 1002)
        ],
    )


def pipe(folder: Path) -> str:
    os.mkfifo(folder / "pipe.bag")
    return str(folder / "pipe.bag")


def pipe_in_a_folder(folder: Path) -> str:
    path = Path(write_folder(folder / "bag", MESSAGES))
    (path / "metadata.yaml").unlink()
    for name in ("metadata.yaml", "another.db3"):
        os.mkfifo(path / name)
    return str(path)


def pipe_as_journal(folder: Path) -> str:
    path = database(folder)
    os.mkfifo(f"{path}-wal")
    return path


def chunk(folder: Path, compression: str, packed: bytes, size: int) -> str:
    """Returns a bag with a chunk that unpacks to much."""
    original = Path(write_bag(folder / "bag.bag", MESSAGES)).read_bytes()
    fields = [b"op=\x05", b"compression=" + compression.encode(), b"size=" + struct.pack("<I", size)]
    header = b"".join(struct.pack("<I", len(field)) + field for field in fields)
    record = struct.pack("<I", len(header)) + header + struct.pack("<I", len(packed)) + packed
    path = folder / "bomb.bag"
    path.write_bytes(original[: 13 + 4096] + record)
    return str(path)


def bz2_bomb(folder: Path) -> str:
    packer = bz2.BZ2Compressor()
    block = bytes(1 << 24)
    packed = b"".join(packer.compress(block) for _ in range(16)) + packer.flush()
    return chunk(folder, "bz2", packed, 1 << 28)


def lz4_bomb(folder: Path) -> str:
    return chunk(folder, "lz4", lz4.frame.compress(bytes(1 << 28)), 1 << 28)


def zstd_bombs(folder: Path) -> str:
    """A chunk whose index names it a thousand times."""
    path = Path(write_mcap(folder / "bomb.mcap", MESSAGES))
    data = path.read_bytes()
    packed = zstandard.ZstdCompressor().compress(bytes(1 << 28))
    record = (
        struct.pack("<QQQI", START_NS, START_NS, 1 << 28, 0) + struct.pack("<I4sQ", 4, b"zstd", len(packed)) + packed
    )
    chunk_record = struct.pack("<BQ", 6, len(record)) + record
    path.write_bytes(data[:8] + chunk_record * 100 + data[8:])
    return str(path)


def without_end(path: Path) -> bytes:
    """Returns an MCAP file up to the record that ends its data."""
    data = path.read_bytes()
    return data[: data.rindex(struct.pack("<BQ", 0x0F, 4))]


def tiny_messages(folder: Path) -> str:
    """A chunk that unpacks to two million messages without data."""
    messages = b"".join(struct.pack("<BQHIQQ", 5, 22, 1, number, START_NS, START_NS) for number in range(20_000))
    content = messages * 100
    packed = zstandard.ZstdCompressor().compress(content)
    size = len(content)
    record = struct.pack("<QQQI", START_NS, START_NS, size, 0) + struct.pack("<I4sQ", 4, b"zstd", len(packed)) + packed
    path = Path(write_mcap(folder / "tiny.mcap", MESSAGES, use_chunking=False))
    path.write_bytes(without_end(path) + struct.pack("<BQ", 6, len(record)) + record)
    return str(path)


def late_messages(folder: Path) -> str:
    """Small chunks that each unpack to 60 MB of messages that are to be held back: together to more than is allowed."""
    path = Path(write_mcap(folder / "late.mcap", MESSAGES, use_chunking=False))
    start = without_end(path)
    chunks = []
    for number in range(10):
        early = struct.pack("<BQHIQQ", 5, 30, 1, 0, START_NS + number, START_NS) + bytes(8)
        late = struct.pack("<BQHIQQ", 5, 22 + 60_000_000, 1, 0, START_NS * 2, START_NS)
        late += os.urandom(10_000) + bytes(60_000_000 - 10_000)  # not so small that its size is implausible
        content = early * 9 + late
        packed = zstandard.ZstdCompressor().compress(content)
        record = struct.pack("<QQQI", 0, 0, len(content), 0) + struct.pack("<I4sQ", 4, b"zstd", len(packed)) + packed
        chunks.append(struct.pack("<BQ", 6, len(record)) + record)
    path.write_bytes(start + b"".join(chunks))
    return str(path)


def packed_file(folder: Path) -> str:
    path = folder / "packed.mcap.zstd"
    path.write_bytes(zstandard.ZstdCompressor().compress(b"\x89MCAP0\r\n" + bytes(1 << 29)))
    return str(path)


def definition(text: str, form: str = "ros2msg") -> Callable[[Path], str]:
    def make(folder: Path) -> str:
        return write_mcap(folder / "a.mcap", MESSAGES, definitions={"std_msgs/msg/Float32": (form, text)})

    return make


def nested_arrays(size: str) -> str:
    parts = [f"A{n}{size} x\n{'=' * 80}\nMSG: std_msgs/A{n}\n" for n in range(8)]
    return "float32 data\n" + "".join(parts)


def long_type_name(folder: Path) -> str:
    path = Path(write_bag(folder / "a.bag", MESSAGES))
    data = path.read_bytes()
    name = b"type=std_msgs/Float32"
    place = data.index(name)
    longer = name + b"a" * 1_000_000
    path.write_bytes(data[: place - 4] + struct.pack("<I", len(longer)) + longer + data[place + len(name) :])
    return str(path)


def long_topics(folder: Path) -> str:
    return database(folder, f"UPDATE topics SET type = 'std_msgs/msg/' || '{'a' * 900_000}'")


ATTACKS: dict[str, Callable[[Path], str]] = {
    "endless view": endless_view,
    "generated blobs": generated_blobs,
    "page that is its own child": page_that_is_its_own_child,
    "large blobs": large_blobs,
    "pipe": pipe,
    "pipe in a folder": pipe_in_a_folder,
    "pipe as journal": pipe_as_journal,
    "bz2 bomb": bz2_bomb,
    "lz4 bomb": lz4_bomb,
    "zstd bombs": zstd_bombs,
    "tiny messages": tiny_messages,
    "late messages": late_messages,
    "packed file": packed_file,
    "parentheses": definition(
        "module std_msgs { module msg { const long X = "
        + "(" * 400
        + "1"
        + ")" * 400
        + "; struct Float32 { float data; }; }; };",
        "ros2idl",
    ),
    "shift": definition(
        "module std_msgs { module msg { const long X = 1<<8000000000; "
        "struct Float32 { float x[X]; float data; }; }; };",
        "ros2idl",
    ),
    "nested arrays": definition(nested_arrays("[100]")),
    "nested sequences": definition(nested_arrays("[]")),
    "huge array": definition(f"B[1000000000] b\nfloat32[] a\nfloat32 data\n{'=' * 80}\nMSG: std_msgs/B\nuint8 x\n"),
    "many fields": definition("".join(f"string f{n}\n" for n in range(60_000)) + "float32 data\n"),
    "long type name": long_type_name,
    "long type name in a database": long_topics,
}


LONG = ("tiny messages", "late messages")
"""Attacks on what both commands read with, whose limits are as large as a test can bear: `replay` reads them alone."""
_RUN = """
import sys
from robot_health_monitor.__main__ import main
codes = [int(main([command, *sys.argv[2:]])) for command in sys.argv[1].split()]
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(codes, status["VmHWM"].split()[0])
"""
"""Runs commands that read recordings; the last line has their exit codes and the memory that they took at most.

Not that of getrusage: it begins with the memory of the process that started this one.
"""


@pytest.mark.newest_python
@pytest.mark.parametrize("attack", ATTACKS)
def test_a_small_recording_takes_little_and_one_line(tmp_path: Path, attack: str) -> None:
    path = ATTACKS[attack](tmp_path)
    thresholds = tmp_path / "thresholds.yaml"
    thresholds.write_text(THRESHOLDS, encoding="utf-8")
    commands = "replay" if attack in LONG else "replay suggest"
    ended = subprocess.run(
        [sys.executable, "-c", _RUN, commands, path, "--thresholds", str(thresholds)],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])},
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
    )
    shutil.rmtree(tmp_path, ignore_errors=True)  # some are large
    assert ended.returncode == 0, ended.stderr[-2000:]
    result = ended.stdout.splitlines()[-1]
    codes, memory_kb = json.loads(result.partition("]")[0] + "]"), int(result.split()[-1])
    problems = ended.stderr.splitlines()
    assert set(codes) <= {0, 1, 2}, ended.stderr[-2000:]
    assert len(problems) <= 10, ended.stderr[-2000:]
    assert all(len(line) < 1000 for line in problems)
    assert memory_kb < MEMORY_KB
