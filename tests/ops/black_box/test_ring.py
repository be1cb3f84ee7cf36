"""Messages in memory: what a recording finds, what goes when memory is full, what is no longer needed."""

from __future__ import annotations

import random
import tracemalloc

from robot_health_monitor.core.messages.raw_messages import RawFormat
from robot_health_monitor.ops.black_box import ring as ring_module
from robot_health_monitor.ops.black_box.ring import OVERHEAD_BYTES, Message, Reader, Ring, RobotRing

CHANNEL = "/a", RawFormat("json", "std_msgs/Float32", "jsonschema", "{}")
SIZE = 100 + OVERHEAD_BYTES


def add(robot: RobotRing, *times_s: float) -> None:
    for time_s in times_s:
        robot.add((time_s, *CHANNEL, bytes(100)))


def everything(reader: Reader) -> list[float]:
    found: list[Message] = []
    while True:
        messages = reader.read(1000)
        if not messages:
            return [time_s for time_s, *_ in found]
        found += messages


def test_a_recording_begins_with_the_state_from_before_its_time() -> None:
    ring = Ring(1e6)
    robot = RobotRing(ring, 10.0)
    for second in range(40):
        if second % 5 == 0:
            robot.begin_segment(float(second), {"battery": {"second": second}}, 0)
        add(robot, second + 0.5)
    reader = robot.reader()
    # At 35 s, 10 s before are needed: the segment of 25 s.
    assert (reader.first.begin_s, reader.first.states) == (25.0, {"battery": {"second": 25}})
    assert everything(reader) == [second + 0.5 for second in range(25, 40)]


def test_a_recording_goes_on_until_its_end() -> None:
    robot = RobotRing(Ring(1e6), 10.0)
    robot.begin_segment(0.0, {}, 0)
    add(robot, 1.0, 2.0)
    reader = robot.reader()
    add(robot, 3.0)
    assert everything(reader) == [1.0, 2.0, 3.0]
    robot.begin_segment(5.0, {}, 0)
    add(robot, 6.0)
    robot.end_reader()
    add(robot, 7.0)
    assert everything(reader) == [6.0]
    assert reader.is_complete


def test_whatever_needs_messages_has_all_of_them() -> None:
    robot = RobotRing(Ring(1e6), 10.0)
    robot.begin_segment(0.0, {}, 0)
    robot.add((1.0, *CHANNEL, bytes(100)))
    assert robot.reach_s(3.0) == 3.0
    robot.add((2.0, *CHANNEL, bytes(100)))
    reader = robot.reader()
    assert [message[0] for message in reader.read(10_000)] == [1.0, 2.0]
    robot.add((3.0, *CHANNEL, bytes(100)))
    robot.begin_segment(5.0, {}, 0)
    robot.add((6.0, *CHANNEL, bytes(20_000)))
    assert everything(reader) == [3.0, 6.0]
    robot.add((7.0, *CHANNEL, bytes(100)))
    assert everything(reader) == [7.0]
    robot.end_reader()
    assert everything(reader) == []


def test_the_next_recording_has_what_the_one_before_has_written() -> None:
    robot = RobotRing(Ring(1e6), 10.0)
    robot.begin_segment(0.0, {}, 0)
    add(robot, 1.0, 2.0)
    first = robot.reader()
    assert everything(first) == [1.0, 2.0]
    robot.end_reader()
    assert everything(robot.reader()) == [1.0, 2.0]


def test_the_oldest_messages_of_all_robots_go_first() -> None:
    ring = Ring(6 * SIZE)
    one, other = RobotRing(ring, 100.0), RobotRing(ring, 100.0)
    one.begin_segment(0.0, {}, 0)
    add(one, 1.0, 2.0, 3.0)
    other.begin_segment(4.0, {}, 0)
    add(other, 5.0, 6.0, 7.0, 8.0, 9.0)
    assert ring.dropped == 2
    assert ring.used_bytes <= 6 * SIZE
    assert (everything(one.reader()), everything(other.reader())) == ([3.0], [5.0, 6.0, 7.0, 8.0, 9.0])
    assert one.reach_s(10.0) == 7.0


def test_messages_that_go_before_they_are_written_are_counted() -> None:
    robot = RobotRing(Ring(3 * SIZE), 100.0)
    robot.begin_segment(0.0, {}, 0)
    add(robot, 1.0, 2.0)
    reader = robot.reader()
    add(robot, 3.0, 4.0, 5.0)  # 1 and 2 go
    assert everything(reader) == [3.0, 4.0, 5.0]
    assert reader.lost == 2


def test_a_message_larger_than_the_memory_is_not_kept() -> None:
    ring = Ring(1000)
    robot = RobotRing(ring, 10.0)
    robot.begin_segment(0.0, {}, 0)
    add(robot, 0.5)
    robot.add((1.0, *CHANNEL, bytes(5000)))
    assert (ring.used_bytes, ring.dropped, ring.too_large) == (SIZE, 1, ("/a", 5000))
    assert everything(robot.reader()) == [0.5]


def test_memory_is_bounded_and_released_whatever_happens() -> None:
    choices = random.Random(22)
    ring = Ring(40 * SIZE)
    robots = [RobotRing(ring, 10.0) for _ in range(3)]
    readers: list[Reader] = []
    now_s = 0.0
    for _ in range(5000):
        now_s += choices.random()
        robot = choices.choice(robots)
        action = choices.random()
        if action < 0.1 or robot.current is None:
            robot.begin_segment(now_s, {}, choices.randrange(3))
        elif action < 0.13:
            robot.end_reader()
            readers.append(robot.reader())
        elif action < 0.2:
            robot.end_reader()
        elif action < 0.5 and readers:
            reader = choices.choice(readers)
            if not reader.read(3 * SIZE) and reader.is_complete:
                readers.remove(reader)
        else:
            add(robot, now_s)
        assert ring.used_bytes <= 40 * SIZE + 3 * 3 * 1500 * 20
    for robot in robots:
        robot.close()
    for reader in readers:
        reader.close()
    assert ring.used_bytes == 0


def test_dropped_messages_leave_nothing_in_memory() -> None:
    robot = RobotRing(Ring(100 * SIZE), 3600.0)
    robot.begin_segment(0.0, {}, 0)
    add(robot, 0.0, 1.0)
    tracemalloc.start()
    try:
        for number in range(2, 100_000):
            add(robot, float(number))
        # Threads that other tests have left may allocate too.
        files = [tracemalloc.Filter(inclusive=True, filename_pattern=name) for name in (ring_module.__file__, __file__)]
        snapshot = tracemalloc.take_snapshot().filter_traces(files)
        assert sum(statistic.size for statistic in snapshot.statistics("filename")) < 150 * SIZE
    finally:
        tracemalloc.stop()
    assert everything(robot.reader()) == [float(number) for number in range(99_900, 100_000)]


def test_what_went_before_the_recording_is_not_lost_for_it() -> None:
    robot = RobotRing(Ring(3 * SIZE), 100.0)
    for begin_s in (0.0, 10.0, 20.0):
        robot.begin_segment(begin_s, {}, 0)
        add(robot, begin_s + 1.0, begin_s + 2.0)  # of six messages, the first three go
    reader = robot.reader()
    assert reader.first.begin_s == 10.0
    assert everything(reader) == [12.0, 21.0, 22.0]
    assert reader.lost == 0


def test_a_recording_of_which_everything_went_begins_with_the_newest_segment() -> None:
    robot = RobotRing(Ring(SIZE // 2), 100.0)
    for begin_s in (0.0, 10.0):
        robot.begin_segment(begin_s, {}, 0)
        add(robot, begin_s + 1.0)
    reader = robot.reader()
    assert (reader.first.begin_s, everything(reader), reader.lost) == (10.0, [], 0)
