"""Writing in a separate thread: the writer never waits, whatever the reader does."""

from __future__ import annotations

import os
import select
import threading
from typing import Iterator, Sequence, TextIO

import pytest
from harness.unread import fill

from robot_health_monitor.cli.output.stream_writer import MOST_ITEMS, StreamWriter

DEADLINE_S = 30.0


def render(items: Sequence[str], dropped: int) -> str:
    return "".join([f"({dropped} dropped)\n"] * bool(dropped) + [f"{item}\n" for item in items])


@pytest.fixture
def pipe() -> Iterator[tuple[int, TextIO]]:
    """The reading end, and the writing end as a stream."""
    reader, writer = os.pipe()
    with open(writer, "w", encoding="utf-8") as stream:
        yield reader, stream
        try:
            os.close(reader)
        except OSError:
            pass  # closed by the test


def read_until(file: int, text: str) -> str:
    """Reads until `text` has come."""
    data = b""
    while text.encode() not in data:
        assert select.select([file], [], [], DEADLINE_S)[0], f"{text!r} did not come, but {data!r}"
        data += os.read(file, 65536)
    return data.decode()


def wait_for(predicate: threading.Event) -> None:
    assert predicate.wait(DEADLINE_S)


@pytest.fixture
def blocked(pipe: tuple[int, TextIO]) -> tuple[int, StreamWriter[str]]:
    """The reading end of a full pipe, and a writer whose thread waits for it with one item."""
    reader, stream = pipe
    fill(stream.fileno())
    taken = threading.Event()

    def render_and_note(items: Sequence[str], dropped: int) -> str:
        taken.set()
        return render(items, dropped)

    writer = StreamWriter(stream, render_and_note)
    writer.start()
    writer.put("line 0.")
    wait_for(taken)
    return reader, writer


def test_items_are_written_in_order_before_the_last_text(pipe: tuple[int, TextIO]) -> None:
    reader, stream = pipe
    writer = StreamWriter(stream, render, last="end\n")
    writer.put("before the start")
    writer.start()
    writer.put("one")
    writer.put("two é")
    assert writer.close()
    assert read_until(reader, "end\n") == "before the start\none\ntwo é\nend\n"


def test_a_reader_that_does_not_read_costs_the_oldest_items_and_no_time(blocked: tuple[int, StreamWriter]) -> None:
    reader, writer = blocked
    for number in range(1, MOST_ITEMS + 101):
        writer.put(f"line {number}.")
    assert writer.problem == "the output is not read: the oldest lines are dropped"
    text = read_until(reader, f"line {MOST_ITEMS + 100}.\n")
    kept = [f"line {number}." for number in range(101, MOST_ITEMS + 101)]
    assert text.lstrip("x").splitlines() == ["line 0.", "(100 dropped)", *kept]
    assert writer.problem == ""
    assert writer.close()


def test_the_end_does_not_wait_for_a_reader_that_does_not_read(blocked: tuple[int, StreamWriter]) -> None:
    _, writer = blocked
    assert not writer.close()
    assert writer.problem


def test_the_end_waits_for_a_thread_that_has_no_processor_time_while_the_stream_is_read(
    pipe: tuple[int, TextIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    reader, stream = pipe
    monkeypatch.setattr("robot_health_monitor.cli.output.stream_writer._CLOSE_S", 0.0)
    scheduled = threading.Event()

    def render_late(items: Sequence[str], dropped: int) -> str:
        wait_for(scheduled)
        return render(items, dropped)

    writer = StreamWriter(stream, render_late)
    writer.start()
    writer.put("one")
    threading.Timer(0.2, scheduled.set).start()
    assert writer.close() and writer.problem == ""
    assert read_until(reader, "\n") == "one\n"


def test_a_reader_that_has_left_is_noticed_at_the_next_write(pipe: tuple[int, TextIO]) -> None:
    reader, stream = pipe
    writer = StreamWriter(stream, render)
    writer.start()
    os.close(reader)
    writer.put("one")
    assert writer.close() and writer.reader_is_gone


def test_a_reader_that_has_left_is_noticed_without_a_write(pipe: tuple[int, TextIO]) -> None:
    reader, stream = pipe
    writer = StreamWriter(stream, render)
    writer.start()
    os.close(reader)
    assert writer._thread is not None
    writer._thread.join(DEADLINE_S)
    assert writer.reader_is_gone


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_a_full_disk_is_reported_once_and_tried_again_without_losing_a_line(
    pipe: tuple[int, TextIO], capfd: pytest.CaptureFixture
) -> None:
    reader, stream = pipe
    with open("/dev/full", "w") as full:
        writer = StreamWriter(full, render)
        writer.start()
        writer.put("one")
        while not writer.problem:
            assert writer._thread is not None and writer._thread.is_alive()
        assert writer.problem == "the output cannot be written: No space left on device"
        writer.put("two")
        os.dup2(stream.fileno(), full.fileno())  # there is space again
        assert read_until(reader, "two\n") == "one\ntwo\n"
        assert writer.close() and writer.problem == ""
    assert capfd.readouterr().err.splitlines() == [
        "robot-health: the output cannot be written: No space left on device; monitoring continues",
        "robot-health: the output can be written again",
    ]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_the_end_does_not_wait_for_a_full_disk() -> None:
    with open("/dev/full", "w") as full:
        writer = StreamWriter(full, render)
        writer.start()
        writer.put("one")
        assert writer.close()
        assert writer.problem == "the output cannot be written: No space left on device"


def test_a_stream_that_another_process_made_non_blocking_loses_nothing(pipe: tuple[int, TextIO]) -> None:
    reader, stream = pipe
    os.set_blocking(stream.fileno(), False)
    writer = StreamWriter(stream, render)
    writer.start()
    lines: list[str] = ["x" * 50_000 + str(number) for number in range(10)]
    for line in lines:
        writer.put(line)
    assert read_until(reader, lines[-1] + "\n") == "".join(f"{line}\n" for line in lines)
    assert writer.close()


def test_a_character_that_the_encoding_lacks_is_escaped(pipe: tuple[int, TextIO]) -> None:
    reader, stream = pipe
    stream.reconfigure(encoding="ascii")
    writer = StreamWriter(stream, render)
    writer.start()
    writer.put("80 °C")
    assert writer.close()
    assert read_until(reader, "\n") == "80 \\xb0C\n"
