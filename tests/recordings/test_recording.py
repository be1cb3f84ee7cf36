"""One recorded file: damage at any place of `.bag` and `.mcap` files is found; the order of messages."""

from __future__ import annotations

from pathlib import Path
from typing import Callable

import pytest
from harness.recorded import read, values, write_bag, write_mcap
from harness.seeds import every

from robot_health_monitor.recordings.recording import RecordingError, in_time_order

MESSAGES = sorted([*values("/battery_level", range(6)), *values("/temperature", range(6), start_s=0.25)])
WRITERS = {
    "none.bag": lambda path: write_bag(path, MESSAGES, chunk_size=300),
    "bz2.bag": lambda path: write_bag(path, MESSAGES, "bz2", chunk_size=300),
    "none.mcap": lambda path: write_mcap(path, MESSAGES, chunk_size=200),
    "zstd.mcap": lambda path: write_mcap(path, MESSAGES, compression="zstd", chunk_size=200),
    "loose.mcap": lambda path: write_mcap(path, MESSAGES, use_chunking=False),
}
HEADER_OF_BAG = range(200, 4000)
"""Padding of a bag's header: one place in it is as good as any other."""


@pytest.mark.newest_python
@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_ends_at_any_byte_is_read_up_to_there_with_one_line(tmp_path: Path, name: str) -> None:
    write: Callable[[Path], str] = WRITERS[name]
    data = Path(write(tmp_path / name)).read_bytes()
    cut = tmp_path / f"cut{Path(name).suffix}"
    for size in range(0, len(data), every(3)):
        if name.endswith(".bag") and size in HEADER_OF_BAG:
            continue
        cut.write_bytes(data[:size])
        try:
            found = read(str(cut))
        except RecordingError as error:
            assert size < 13, size
            assert str(error).startswith(f"{cut}: expected ")  # noqa: PT017
            continue
        assert found.messages == MESSAGES[: len(found.messages)], size
        (problem,) = found.problems
        assert problem.endswith(("read up to there", "read to its end")), size
        assert "\n" not in problem and "buffer" not in problem, size


@pytest.mark.newest_python
def test_a_wrong_bit_anywhere_in_an_mcap_file_is_noticed_or_harmless(tmp_path: Path) -> None:
    data = Path(WRITERS["none.mcap"](tmp_path / "a.mcap")).read_bytes()
    path = tmp_path / "damaged.mcap"
    for place in range(0, len(data), every(3)):
        damaged = bytearray(data)
        damaged[place] ^= 1 << place % 8
        path.write_bytes(damaged)
        try:
            found = read(str(path))
        except RecordingError:
            continue
        assert found.messages == MESSAGES or found.problems, place


def test_messages_that_a_bag_lost_are_noticed(tmp_path: Path) -> None:
    """One bit makes a message a record of another kind, which the format allows."""
    path = Path(WRITERS["none.bag"](tmp_path / "a.bag"))
    data = path.read_bytes()
    path.write_bytes(data.replace(b"op=\x02", b"op=\x04", 1))
    found = read(str(path))
    assert len(found.messages) == len(MESSAGES) - 1
    assert found.problems == [f"{path}: damaged: expected 12 messages, got 11"]


def test_a_connection_that_the_index_of_a_bag_lost_is_found_in_the_chunks(tmp_path: Path) -> None:
    path = Path(WRITERS["none.bag"](tmp_path / "a.bag"))
    data = path.read_bytes()
    place = data.rindex(b"op=\x07")
    path.write_bytes(data[:place] + b"op=\x03" + data[place + 4 :])
    found = read(str(path))
    assert found.messages == MESSAGES
    assert found.problems == [f"{path}: has no index (the recorder was stopped early): read to its end"]


def entries(*times: int) -> list:  # type: ignore[type-arg]
    return [(time, 1, b"") for time in times]


def times(chunks: list) -> list:  # type: ignore[type-arg]
    return [time for time, _, _ in in_time_order(chunks)]


def test_messages_inside_a_chunk_are_sorted() -> None:
    assert times([entries(3, 1, 2), entries(4)]) == [1, 2, 3, 4]


def test_neighbouring_chunks_may_overlap() -> None:
    assert times([entries(1, 2, 5), entries(3, 4, 6), [], entries(7)]) == [1, 2, 3, 4, 5, 6, 7]


def test_messages_at_the_same_time_stay_in_their_order() -> None:
    chunks = [[(1, 1, b"a"), (1, 2, b"b")], [(1, 1, b"c"), (0, 1, b"z")]]
    assert [data for _, _, data in in_time_order(chunks)] == [b"z", b"a", b"b", b"c"]
