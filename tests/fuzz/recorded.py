"""What is fuzzed of recordings: definitions of types, messages by them, databases, bags and MCAP files."""

from __future__ import annotations

import contextlib
import random
import struct
import tempfile
from pathlib import Path
from typing import Any

from fuzz.mutations import mutate_bytes
from fuzz.targets import Target, check_text, size_of
from fuzz.work import Work
from harness.recorded import ROS2, Recorded, definition, values, write_bag, write_folder, write_mcap

from robot_health_monitor.core.messages.raw_messages import RawFormat
from robot_health_monitor.core.proposal.candidates import Candidates, Topic
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.recordings.decoding import type_of
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings
from robot_health_monitor.recordings.recording import Channel, RecordingError

_SEPARATOR = b"=" * 80 + b"\n"
_NUMBERS = [b"0", b"1", b"8", b"100", b"255", b"4096", b"65536", b"2147483647", b"99999999999"]


class Definitions(Target):
    """Definitions of types, the fields in them, and messages that are read by them."""

    name = "definitions"
    errors = (ConfigError,)
    seeds = (
        (
            "msg",
            b"std_msgs/Header header\nA[3] x\nfloat64[36] y\nstring<=5[<=9] z\nint32 C=1\n"
            + _SEPARATOR
            + b"MSG: a/A\nuint8 b\n",
        ),
        ("msg", b"A x\nA y\n" + _SEPARATOR + b"MSG: a/A\nB[] x\nB y\n" + _SEPARATOR + b"MSG: a/B\n"),
        ("msg", definition(ROS2, "sensor_msgs/msg/BatteryState").encode()),
        ("msg", definition(ROS2, "diagnostic_msgs/msg/DiagnosticArray").encode()),
        (
            "idl",
            b"module a { module msg { const long N = 3; typedef double d__9[9]; enum E { X, Y };\n"
            b'@verbatim(language="c", text="t") struct T { @unit(value="m") d__9 k; sequence<long, N> s; a::msg::U u;\n'
            b"string<5> t; unsigned long long v[N], w; E e; }; struct U { octet o; }; }; };",
        ),
    )
    pieces = (
        *_NUMBERS, b"(", b"[", b"]", b"<", b">", b"{", b"}", b"};", b"::", b"sequence<", b"@a(", b"/*", b"*/", b"//",
        b"#", b'"', b"1<<99", b"*", b"=", b"[1,", b"string ", b"wstring ", b"struct X {", b"module a {", b"typedef ",
        b"a/T x\n", b"B[100] x\n", b"MSG: a/T\n", _SEPARATOR, b"\x00", b"\xff", b" " * 500, b"x" * 500,
    )  # fmt: skip

    def make(self, chance: random.Random) -> tuple[str, str, str, bytes]:
        form, text = chance.choice(self.seeds)
        form = form if chance.random() < 0.95 else "idl"
        changed = mutate_bytes(chance, text, self.pieces).decode("utf-8", "replace")
        parts = [struct.pack("<I", chance.choice((0, 1, 2, 5, 2**31, 2**32 - 1))) for _ in range(chance.randrange(40))]
        return form, chance.choice(("cdr", "ros1")), changed, b"\0\1\0\0" + b"".join(parts)

    def use(self, data: tuple[str, str, str, bytes]) -> None:
        form, encoding, text, message = data
        types = type_of(Channel("/x", RawFormat(encoding, "a/T", f"ros2{form}", text)))
        candidates = Candidates()
        candidates.add([Topic("/x", "a/T", types.definitions)])
        for field in ["", *(each.given["field"] for each in list(candidates.signals.values())[:20])]:
            with contextlib.suppress(ValueError):
                types.field_getter(field)(message)

    def allowed(self, data: Any) -> Work:
        return Work(150_000 + 1_000 * size_of(data), 5_000_000 + 2_000 * size_of(data))


class RecordedFiles(Target):
    """Databases, bags and MCAP files: read and decoded to their end."""

    name = "recordings"
    errors = (ConfigError, RecordingError)
    pieces = (
        *_NUMBERS, *(struct.pack("<I", int(number) & 0xFFFFFFFF) for number in _NUMBERS),
        *(struct.pack("<Q", int(number)) for number in _NUMBERS), *(struct.pack(">I", number) for number in range(9)),
        b"op=\x05", b"compression=bz2", b"\x06", b"CREATE VIEW", b"messages", b"\xff" * 8, bytes(64),
    )  # fmt: skip

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
        messages: list[Recorded] = [*values("/x", range(60)), *values("/y", range(30), period_s=2.0)]
        files = [
            write_bag(self._folder / f"{kind}.bag", messages, kind, chunk_size=500) for kind in ("none", "bz2", "lz4")
        ]
        files += [
            write_mcap(self._folder / f"{kind}.mcap", messages, compression=kind, chunk_size=700)
            for kind in ("none", "lz4", "zstd")
        ]
        files += map(str, Path(write_folder(self._folder / "bag", messages)).glob("*.db3"))
        self._files = [(Path(file).suffix, Path(file).read_bytes()) for file in files]

    def make(self, chance: random.Random) -> tuple[str, bytes]:
        suffix, data = chance.choice(self._files)
        return suffix, mutate_bytes(chance, data, self.pieces)

    def use(self, data: tuple[str, bytes]) -> None:
        path = self._folder / f"fuzzed{data[0]}"
        path.write_bytes(data[1])
        with Recordings([str(path)]) as recordings:
            player = Player(recordings)
            node = player.node("node", {})
            for channel in recordings.channels:
                for field in ("data", None):
                    with contextlib.suppress(ConfigError):
                        node.subscribe(channel.topic, "", lambda value, now_s: None, field=field)
            try:
                player.play()
            finally:
                for line in player.problems:
                    check_text(line.encode("ascii", "replace").decode(), 600)

    def allowed(self, data: Any) -> Work:
        return Work(2_000_000 + 200 * size_of(data), 300_000_000)

    def close(self) -> None:
        for path in sorted(self._folder.rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()
        self._folder.rmdir()


RECORDED_TARGETS = (Definitions, RecordedFiles)
