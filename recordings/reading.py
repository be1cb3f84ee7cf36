"""Recordings of every format, one or several, as one stream of messages in the order of their log times."""

from __future__ import annotations

import heapq
import math
import os
import re
import shutil
import tempfile
from typing import Any, Collection, Iterator, List, Mapping, Optional, Sequence, Tuple

from robot_health_monitor.core.errors import ConfigError, Problems
from robot_health_monitor.core.formatting import count_text
from robot_health_monitor.core.yaml_loader import load
from robot_health_monitor.runtime.libraries import RECORDINGS, libraries

from .recording import (
    LARGEST,
    Channel,
    Damaged,
    RawMessage,
    RecordedFile,
    RecordingError,
    Target,
    check_size,
)
from .ros1_bag import Ros1Bag
from .sqlite_file import SqliteFile

_METADATA = "metadata.yaml"
_LARGEST_METADATA = 2_000_000
_MOST_FILES = 10_000
_LARGEST_UNPACKED = 64 << 20
_LARGEST_RATIO = 200
"""A file that is packed as a whole unpacks to at most 64 MB and this many times its size."""
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_EXPECTED = "expected a .bag file, an .mcap file, a .db3 file or a folder that rosbag2 recorded"


class Recordings:
    """Several recorded files, read as one. Use as a context manager: unpacked files are removed at its end."""

    def __init__(self, paths: Sequence[str]) -> None:
        """Opens recordings.

        Args:
            paths: `.bag`, `.mcap` and `.db3` files, and folders of rosbag2.

        Raises:
            RecordingError: one of them cannot be read at all, or has no message that can be read.
        """
        self.paths = [os.fspath(path) for path in paths]
        """The recordings, as they were given."""
        self._folder: Optional[str] = None
        self._notes: List[str] = []
        self._recordings: List[List[RecordedFile]] = []
        try:
            for path in self.paths:
                files = self._open(path)
                if _span(files) is None:
                    raise RecordingError(_nothing_readable(path, self.problems + _problems(files)), file=path)
                self._recordings.append(files)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Recordings:
        """Returns itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Removes unpacked files."""
        self.close()

    def close(self) -> None:
        """Removes unpacked files. May be called twice."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    @property
    def channels(self) -> List[Channel]:
        """The channels of all files, each once."""
        return list(dict.fromkeys(channel for file in self._files for channel in file.channels))

    @property
    def span_ns(self) -> Optional[Tuple[int, int]]:
        """Log times of the first and the last message of all files; None without messages."""
        return _span(self._files)

    @property
    def gaps_ns(self) -> List[Tuple[int, int]]:
        """Log times of the last message before, and the first one after, each time in which nothing was recorded.

        Between recordings only: the files of one folder are one recording, and silence within it is the robot's.
        """
        gaps: List[Tuple[int, int]] = []
        covered_ns: Optional[int] = None
        for first, last in sorted(span for span in map(_span, self._recordings) if span is not None):
            if covered_ns is not None and first > covered_ns:
                gaps.append((covered_ns, first))
            covered_ns = last if covered_ns is None else max(covered_ns, last)
        return gaps

    @property
    def problems(self) -> List[str]:
        """One line for each thing that could not be read until now."""
        return list(dict.fromkeys(self._notes + _problems(self._files)))

    def messages(self, targets: Sequence[Mapping[Channel, Target]]) -> Iterator[RawMessage[Target]]:
        """Yields the messages of some channels in the order of their log times.

        Args:
            targets: for each of `paths` its channels, each with what to yield with its messages.
        """
        streams = [
            (file.span_ns[0], file.messages(wanted))
            for files, wanted in zip(self._recordings, targets)
            for file in files
            if file.span_ns is not None and any(channel in wanted for channel in file.channels)
        ]
        return streams[0][1] if len(streams) == 1 else _merged(streams)

    def problem_without(self, number: int, wanted: Collection[Channel]) -> str:
        """Returns why a recording gave no message of some channels: it is damaged. Empty: it is not, or has none.

        Args:
            number: its place in `paths`.
            wanted: the channels.
        """
        files = self._recordings[number]
        of_interest = [file for file in files if any(channel in wanted for channel in file.channels)]
        problems = _problems(of_interest)
        return _nothing_readable(self.paths[number], problems) if problems else ""

    @property
    def _files(self) -> List[RecordedFile]:
        return [file for files in self._recordings for file in files]

    def _open(self, path: str) -> List[RecordedFile]:
        if os.path.isdir(path):
            return self._open_folder(path)
        if not os.path.exists(path):
            raise RecordingError("no such file", file=path)
        if not os.path.isfile(path):
            raise RecordingError(f"is not a file; {_EXPECTED}", file=path)
        return [_unpacked(self._open_file(path))]

    def _open_file(self, name: str) -> RecordedFile:
        kind = name[: -len(".zstd")] if name.endswith(".zstd") else name
        if not kind.endswith((".bag", ".bag.active", ".mcap", ".mcap.active", ".db3")):
            raise RecordingError(_EXPECTED, file=name)
        path = name if kind == name else self._unpack_file(name)
        if kind.endswith((".bag", ".bag.active")):
            return Ros1Bag(path, name)
        if kind.endswith(".db3"):
            return SqliteFile(path, name)
        with libraries(*RECORDINGS):
            from .mcap_file import McapFile
        return McapFile(path, name)

    def _open_folder(self, path: str) -> List[RecordedFile]:
        metadata = self._read_metadata(path)
        names = metadata.get("relative_file_paths")
        try:
            files = os.listdir(path)
        except OSError as error:
            raise RecordingError(f"cannot be read: {error.strerror or error}", file=path) from None
        recorded = [name for name in files if re.search(r"\.(mcap|db3)(\.zstd)?\Z", name)]
        present = sorted((name for name in recorded if os.path.isfile(os.path.join(path, name))), key=_natural)
        if isinstance(names, list) and names:
            listed = [os.path.basename(name) for name in names[:_MOST_FILES] if isinstance(name, str)]
            for name in listed:
                if name not in present:
                    self._notes.append(f"{os.path.join(path, name)}: cannot be found: left out")
            present = [name for name in listed if name in present] or present
        if not present:
            raise RecordingError(f"has no .mcap or .db3 file; {_EXPECTED}", file=path)
        mode = str(metadata.get("compression_mode") or "").lower()
        compression = str(metadata.get("compression_format") or "").lower()
        if mode in ("file", "message") and compression != "zstd":
            raise RecordingError(f"expected compression zstd, got {compression[:40]!r}", file=path)
        opened = [self._open_file(os.path.join(path, name)) for name in present]
        if not metadata:
            return list(map(_unpacked, opened))
        return [_PackedMessages(file) for file in opened] if mode == "message" else opened

    def _read_metadata(self, path: str) -> Mapping[str, Any]:
        file = os.path.join(path, _METADATA)
        try:
            if os.path.exists(file) and not os.path.isfile(file):
                raise TypeError
            with open(file, encoding="utf-8") as stream:
                tree = load(stream.read(_LARGEST_METADATA), Problems()).value
            found = tree["rosbag2_bagfile_information"]
            if not isinstance(found, dict):
                raise TypeError
        except FileNotFoundError:
            problem = "does not exist (the recorder was stopped early)"
        except (OSError, UnicodeDecodeError, ConfigError, KeyError, TypeError, ValueError, RecursionError):
            problem = "cannot be read"
        else:
            return found
        self._notes.append(f"{file}: {problem}: all .mcap and .db3 files of the folder are read")
        return {}

    def _unpack_file(self, path: str) -> str:
        """Unpacks a file that is compressed as a whole; returns the path of the unpacked one."""
        with libraries(*RECORDINGS):
            import zstandard

        unpacked = ""
        try:
            if self._folder is None:
                self._folder = tempfile.mkdtemp(prefix="robot-health-")
            unpacked = os.path.join(self._folder, f"{len(os.listdir(self._folder))}")
            limit = _LARGEST_UNPACKED + _LARGEST_RATIO * os.path.getsize(path)
            with open(unpacked, "wb") as target, open(path, "rb") as packed:
                stream = zstandard.ZstdDecompressor(max_window_size=LARGEST).stream_reader(
                    packed, read_across_frames=True
                )
                while True:
                    block = stream.read(1 << 20)
                    target.write(block[:limit])
                    limit -= len(block)
                    if not block:
                        break
                    if limit < 0:
                        self._notes.append(f"{path}: unpacks to an implausible size: read only its beginning")
                        break
        except (OSError, zstandard.ZstdError) as error:
            if not os.path.isfile(unpacked):
                raise RecordingError(f"cannot be read: {error}", file=path) from None
            self._notes.append(f"{path}: damaged ({error}): read as far as possible")
        return unpacked


class _PackedMessages:
    """A file of messages that are each packed with zstd; implements `recording.RecordedFile`."""

    def __init__(self, file: RecordedFile) -> None:
        with libraries(*RECORDINGS):
            import zstandard

        self._file = file
        self._decompressor = zstandard.ZstdDecompressor(max_window_size=LARGEST)
        self._errors = zstandard.ZstdError
        self._size_of = zstandard.frame_content_size
        self._damaged = 0

    @property
    def name(self) -> str:
        return self._file.name

    @property
    def channels(self) -> Sequence[Channel]:
        return self._file.channels

    @property
    def span_ns(self) -> Optional[Tuple[int, int]]:
        return self._file.span_ns

    @property
    def problem(self) -> str:
        if not self._damaged or self._file.problem:
            return self._file.problem
        return f"{self.name}: damaged: {count_text(self._damaged, 'message')} cannot be unpacked and left out"

    def messages(self, targets: Mapping[Channel, Target]) -> Iterator[RawMessage[Target]]:
        for time_ns, target, data in self._file.messages(targets):
            try:
                check_size(self._size_of(data), len(data))
                unpacked = self._decompressor.decompress(data, max_output_size=LARGEST)
            except (self._errors, Damaged):
                self._damaged += 1
            else:
                yield time_ns, target, unpacked


def _unpacked(file: RecordedFile) -> RecordedFile:
    """Returns a file whose metadata are missing; they would say whether its messages are packed one by one."""
    channels = {channel: None for channel in file.channels if channel.encoding == "cdr"}
    first = next(iter(file.messages(channels)), None) if channels else None
    is_packed = first is not None and first[2].startswith(_ZSTD_MAGIC)  # CDR begins with a zero
    return _PackedMessages(file) if is_packed else file


def _problems(files: Sequence[RecordedFile]) -> List[str]:
    return [file.problem for file in files if file.problem]


def _nothing_readable(path: str, problems: Sequence[str]) -> str:
    """Returns the problem of a recording without messages that can be read, with the first reason for it."""
    of_path = [problem[len(path) :].lstrip("/") for problem in problems if problem.startswith(path)]
    reason = f": {of_path[0].lstrip(': ')}" if of_path else ""
    return f"has no message that can be read{reason}"


def _merged(streams: Sequence[Tuple[int, Iterator[RawMessage[Target]]]]) -> Iterator[RawMessage[Target]]:
    """Yields the messages of several files in the order of their times, as heapq.merge does.

    A file is opened when its messages begin: a long recording may consist of thousands.

    Args:
        streams: the log time at which each begins, and its messages.
    """
    waiting = sorted(enumerate(streams), key=lambda each: each[1][0], reverse=True)
    heads: List[Tuple[int, int, RawMessage[Target], Iterator[RawMessage[Target]]]] = []
    while waiting or heads:
        while waiting and (not heads or waiting[-1][1][0] <= heads[0][0]):
            number, (_, rest) = waiting.pop()
            first = next(rest, None)
            if first is not None:
                heapq.heappush(heads, (first[0], number, first, rest))
        if not heads:
            continue
        _, number, message, rest = heads[0]
        yield message
        following = next(rest, None)
        if len(heads) == 1:  # the only file at this time
            end_ns = waiting[-1][1][0] if waiting else math.inf
            while following is not None and following[0] < end_ns:
                yield following
                following = next(rest, None)
        if following is None:
            heapq.heappop(heads)
        else:
            heapq.heapreplace(heads, (following[0], number, following, rest))


def _span(files: Sequence[RecordedFile]) -> Optional[Tuple[int, int]]:
    spans = [file.span_ns for file in files if file.span_ns is not None]
    return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None


def _natural(name: str) -> List[Tuple[int, str]]:
    """Sorts `bag_2` before `bag_10`."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", name)]
