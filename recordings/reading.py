"""Recordings of every format, one or several, as one stream of messages in the order of their log times."""

from __future__ import annotations

import heapq
import os
import re
import shutil
import tempfile
from typing import Any, Callable, Iterator, List, Mapping, Optional, Sequence, Tuple

from .recording import Channel, RawMessage, RecordedFile, RecordingError, Target
from .ros1_bag import Ros1Bag
from .sqlite_file import SqliteFile

_METADATA = "metadata.yaml"
_LARGEST_METADATA = 10_000_000
_MOST_FILES = 10_000
_LARGEST_MESSAGE = 1 << 30
_EXPECTED = "expected a .bag file, an .mcap file, a .db3 file or a folder that rosbag2 recorded"


class Recordings:
    """Several recorded files, read as one. Use as a context manager: unpacked files are removed at its end."""

    def __init__(self, paths: Sequence[str]) -> None:
        """Opens recordings.

        Args:
            paths: `.bag`, `.mcap` and `.db3` files, and folders of rosbag2.

        Raises:
            RecordingError: one of them cannot be read at all.
        """
        self._folder: Optional[str] = None
        self._notes: List[str] = []
        self._files: List[RecordedFile] = []
        try:
            for path in paths:
                self._files += self._open(os.fspath(path))
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
        spans = [file.span_ns for file in self._files if file.span_ns is not None]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    @property
    def problems(self) -> List[str]:
        """One line for each thing that could not be read until now."""
        return list(dict.fromkeys(self._notes + [file.problem for file in self._files if file.problem]))

    def messages(self, targets: Mapping[Channel, Target]) -> Iterator[RawMessage[Target]]:
        """Yields the messages of some channels in the order of their log times.

        Args:
            targets: the channels, each with what to yield with its messages.
        """
        streams = [file.messages(targets) for file in self._files if any(key in targets for key in file.channels)]
        return streams[0] if len(streams) == 1 else heapq.merge(*streams, key=_log_time)

    def _open(self, path: str) -> List[RecordedFile]:
        if os.path.isdir(path):
            return self._open_folder(path)
        if not os.path.exists(path):
            raise RecordingError(f"{path}: no such file")
        if not os.path.isfile(path):
            raise RecordingError(f"{path}: is not a file; {_EXPECTED}")
        return [self._open_file(path)]

    def _open_file(self, path: str, unpack: Optional[Callable[[bytes], bytes]] = None) -> RecordedFile:
        name = path
        if path.endswith(".zstd"):
            path = self._unpack_file(path)
        if path.endswith((".bag", ".bag.active")):
            return Ros1Bag(path)
        if path.endswith((".mcap", ".mcap.active")):
            return _mcap_file(path)
        if path.endswith(".db3"):
            return SqliteFile(path, unpack, name)
        raise RecordingError(f"{name}: {_EXPECTED}")

    def _open_folder(self, path: str) -> List[RecordedFile]:
        metadata = self._read_metadata(path)
        names = metadata.get("relative_file_paths")
        present = sorted(
            (name for name in os.listdir(path) if re.search(r"\.(mcap|db3)(\.zstd)?\Z", name)), key=_natural
        )
        if isinstance(names, list) and names:
            listed = [os.path.basename(str(name)) for name in names[:_MOST_FILES]]
            for name in listed:
                if name not in present:
                    self._notes.append(f"{os.path.join(path, name)}: is missing: its part of the recording is left out")
            present = [name for name in listed if name in present] or present
        if not present:
            raise RecordingError(f"{path}: holds no .mcap or .db3 file; {_EXPECTED}")
        mode = str(metadata.get("compression_mode") or "").lower()
        unpack = _message_unpacker() if mode == "message" else None
        return [self._open_file(os.path.join(path, name), unpack) for name in present]

    def _read_metadata(self, path: str) -> Mapping[str, Any]:
        import yaml

        file = os.path.join(path, _METADATA)
        try:
            with open(file, encoding="utf-8") as stream:
                tree = yaml.safe_load(stream.read(_LARGEST_METADATA))
            found = tree["rosbag2_bagfile_information"]
            if not isinstance(found, dict):
                raise TypeError
        except FileNotFoundError:
            problem = "is missing (the recorder was stopped early)"
        except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError, RecursionError):
            problem = "cannot be read"
        else:
            return found
        self._notes.append(f"{file}: {problem}: every .mcap and .db3 file of the folder is read")
        return {}

    def _unpack_file(self, path: str) -> str:
        """Unpacks a file that is compressed as a whole; returns the path of the unpacked one."""
        import zstandard

        if self._folder is None:
            self._folder = tempfile.mkdtemp(prefix="robot-health-")
        unpacked = os.path.join(self._folder, f"{len(os.listdir(self._folder))}-{os.path.basename(path)[:-5]}")
        try:
            with open(path, "rb") as packed, open(unpacked, "wb") as target:
                shutil.copyfileobj(zstandard.ZstdDecompressor().stream_reader(packed), target, 1 << 20)
        except (OSError, zstandard.ZstdError) as error:
            self._notes.append(f"{path}: damaged ({error}): unpacked as far as possible")
        return unpacked


def _mcap_file(path: str) -> RecordedFile:
    from .mcap_file import McapFile  # needs the library mcap, which other formats do not

    return McapFile(path)


def _message_unpacker() -> Callable[[bytes], bytes]:
    import zstandard

    decompressor = zstandard.ZstdDecompressor()

    def unpack(data: bytes) -> bytes:
        try:
            return bytes(decompressor.decompress(data, max_output_size=_LARGEST_MESSAGE))
        except zstandard.ZstdError as error:
            raise ValueError(f"a message cannot be unpacked: {error}") from None

    return unpack


def _log_time(message: RawMessage[Any]) -> int:
    return message[0]


def _natural(name: str) -> List[Tuple[int, str]]:
    """Sorts `bag_2` before `bag_10`."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", name)]
