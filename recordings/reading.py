"""Recordings of every format, one or several, as one stream of messages in the order of their log times."""

from __future__ import annotations

import contextlib
import heapq
import os
import re
import shutil
import tempfile
from itertools import accumulate, chain
from operator import itemgetter
from typing import Collection, Iterator, Mapping, Sequence

from ..runtime.libraries import RECORDINGS, libraries
from .recording import LARGEST, Channel, RawMessage, RecordedFile, RecordingError, Span, Target, log_time
from .ros1_bag import Ros1Bag
from .sqlite_file import SqliteFile

_METADATA = "metadata.yaml"
_RECORDED = re.compile(r"\.(mcap|db3)(\.zstd)?\Z")
_LARGEST_METADATA = 2_000_000
_MOST_FILES = 10_000
_LARGEST_UNPACKED = 64 << 20
_LARGEST_RATIO = 200  # A file that is packed as a whole unpacks to at most 64 MB and this many times its size
_EXPECTED = "expected a .bag file, an .mcap file, a .db3 file or a folder that rosbag2 recorded"


class Recordings(contextlib.ExitStack):
    """Several recorded files, read as one. Use as a context manager: unpacked files are removed at its end."""

    def __init__(self, paths: Sequence[str]) -> None:
        """Opens `.bag`, `.mcap` and `.db3` files, and folders of rosbag2.

        Raises RecordingError if one cannot be read.
        """
        super().__init__()
        self.paths = [os.fspath(path) for path in paths]
        self._notes: list[str] = []
        self._recordings: list[list[RecordedFile]] = []
        try:
            for path in self.paths:
                files = self._open(path)
                if _span(files) is None:
                    raise RecordingError(_nothing_readable(path, self.problems + _problems(files)), file=path)
                self._recordings.append(files)
        except BaseException:
            self.close()
            raise

    @property
    def channels(self) -> list[Channel]:
        """The channels of all files, each once."""
        return list(dict.fromkeys(channel for file in self._files for channel in file.channels))

    @property
    def span_ns(self) -> Span:
        """Log times of the first and the last message of all files; None without messages."""
        return _span(self._files)

    @property
    def attachments(self) -> Mapping[str, str]:
        """The texts that a black box has attached, by name; empty for several files."""
        files = self._files
        return files[0].attachments if len(files) == 1 else {}

    @property
    def gaps_ns(self) -> list[tuple[int, int]]:
        """Log times of the last message before, and the first one after, each time in which nothing was recorded.

        Between recordings only: the files of one folder are one recording, and silence within it is the robot's.
        """
        spans = sorted(filter(None, map(_span, self._recordings)))
        ends_ns = accumulate((last for _, last in spans), max)
        return [(end_ns, first) for end_ns, (first, _) in zip(ends_ns, spans[1:]) if first > end_ns]

    @property
    def problems(self) -> list[str]:
        """One line for each thing that could not be read until now."""
        return list(dict.fromkeys(self._notes + _problems(self._files)))

    def messages(self, targets: Mapping[Channel, Target], number: int | None = None) -> Iterator[RawMessage[Target]]:
        """Yields messages in the order of their log times, of the recording `paths[number]` or of all.

        `targets` are the channels, each with what to yield with its messages.
        """
        files = self._files if number is None else self._recordings[number]
        # Files of which each ends before the next begins are read in a row, and opened when their messages begin: a
        # long recording may consist of thousands.
        rows: list[list[tuple[tuple[int, int], RecordedFile]]] = []
        spans = [(file.span_ns, file) for file in _files_with(files, targets) if file.span_ns is not None]
        for span, file in sorted(spans, key=itemgetter(0)):
            row = next((row for row in rows if row[-1][0][1] <= span[0]), None)
            if row is None:
                row = []
                rows.append(row)
            row.append((span, file))
        streams = [chain.from_iterable(file.messages(targets) for _, file in row) for row in rows]
        return heapq.merge(*streams, key=log_time)

    def have_holes(self, channels: Collection[Channel]) -> bool:
        """Whether messages of channels may have been left out, in what was read until now."""
        return any(file.has_holes for file in _files_with(self._files, channels))

    def problem_without(self, number: int, wanted: Collection[Channel]) -> str:
        """Returns why the recording `paths[number]` gave no message of some channels: it is damaged.

        Empty if it is not damaged, or has no such channels.
        """
        problems = _problems(_files_with(self._recordings[number], wanted))
        return _nothing_readable(self.paths[number], problems) if problems else ""

    @property
    def _files(self) -> list[RecordedFile]:
        return [file for files in self._recordings for file in files]

    def _open(self, path: str) -> list[RecordedFile]:
        if os.path.isdir(path):
            return self._open_folder(path)
        if not os.path.exists(path):
            raise RecordingError("no such file", file=path)
        if not os.path.isfile(path):
            raise RecordingError(f"is not a file; {_EXPECTED}", file=path)
        return [self._open_file(path)]

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

    def _open_folder(self, path: str) -> list[RecordedFile]:
        try:
            present = sorted(filter(_RECORDED.search, os.listdir(path)))
        except OSError as error:
            raise RecordingError(f"cannot be read: {error.strerror or error}", file=path) from None
        present = [name for name in present if os.path.isfile(os.path.join(path, name))]
        listed = self._listed_files(os.path.join(path, _METADATA))
        for name in listed:
            if name not in present:
                self._notes.append(f"{os.path.join(path, name)}: cannot be found: left out")
        present = [name for name in listed if name in present] or present
        if not present:
            raise RecordingError(f"has no .mcap or .db3 file; {_EXPECTED}", file=path)
        return [self._open_file(os.path.join(path, name)) for name in present]

    def _listed_files(self, metadata: str) -> list[str]:
        """Returns the names of the recorded files that a file of metadata lists; none, with a note, if it has none.

        Each name has its own line in what rosbag2 writes; older metadata has the folder's former name before it.
        """
        text = ""
        with contextlib.suppress(OSError, ValueError):
            if os.path.isfile(metadata):
                with open(metadata, encoding="utf-8") as stream:
                    text = stream.read(_LARGEST_METADATA)
        lines = (line.rpartition("path:")[2].strip(" -'\"") for line in text.splitlines())
        names = list(dict.fromkeys(map(os.path.basename, filter(_RECORDED.search, lines))))
        if not names:
            problem = "lists no file" if os.path.exists(metadata) else "does not exist (the recorder was stopped early)"
            self._notes.append(f"{metadata}: {problem}: all .mcap and .db3 files of the folder are read")
        return names[:_MOST_FILES]

    def _unpack_file(self, path: str) -> str:
        """Unpacks a file that is compressed as a whole; returns the path of the unpacked one."""
        with libraries(*RECORDINGS):
            import zstandard

        unpacked = ""
        try:
            folder = tempfile.mkdtemp(prefix="robot-health-")
            self.callback(shutil.rmtree, folder, ignore_errors=True)
            unpacked = os.path.join(folder, "unpacked")
            limit = _LARGEST_UNPACKED + _LARGEST_RATIO * os.path.getsize(path)
            unpacker = zstandard.ZstdDecompressor(max_window_size=LARGEST)
            with open(unpacked, "wb") as target, open(path, "rb") as packed:
                stream = unpacker.stream_reader(packed, read_across_frames=True)
                for block in iter(lambda: stream.read(1 << 20), b""):
                    target.write(block[:limit])
                    limit -= len(block)
                    if limit < 0:
                        self._notes.append(f"{path}: unpacks to an implausible size: read only its beginning")
                        break
        except (OSError, zstandard.ZstdError) as error:
            if not os.path.isfile(unpacked):
                raise RecordingError(f"cannot be read: {error}", file=path) from None
            self._notes.append(f"{path}: damaged ({error}): read as far as possible")
        return unpacked


def _files_with(files: Sequence[RecordedFile], channels: Collection[Channel]) -> list[RecordedFile]:
    return [file for file in files if any(channel in channels for channel in file.channels)]


def _problems(files: Sequence[RecordedFile]) -> list[str]:
    return [file.problem for file in files if file.problem]


def _nothing_readable(path: str, problems: Sequence[str]) -> str:
    """Returns the problem of a recording without messages that can be read, with the first reason for it."""
    of_path = [problem[len(path) :].lstrip("/") for problem in problems if problem.startswith(path)]
    reason = f": {of_path[0].lstrip(': ')}" if of_path else ""
    return f"has no message that can be read{reason}"


def _span(files: Sequence[RecordedFile]) -> Span:
    spans = [file.span_ns for file in files if file.span_ns is not None]
    return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None
