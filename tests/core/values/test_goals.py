"""The goals of an action as samples; the numbers of the states are those of the .msg files."""

from __future__ import annotations

import random
from typing import Any, Mapping, Sequence, Tuple

import pytest

from robot_health_monitor.core.values.goals import MOST_GOALS, Goals

Listed = Sequence[Tuple[str, int]]


def ros1(goals: Listed) -> Mapping[str, Any]:
    stamp = {"secs": 1, "nsecs": 0}
    return {
        "status_list": [{"goal_id": {"stamp": stamp, "id": goal}, "status": code, "text": ""} for goal, code in goals]
    }


def ros2(goals: Listed) -> Mapping[str, Any]:
    stamp = {"sec": 1, "nanosec": 0}
    return {
        "status_list": [
            {"goal_info": {"goal_id": {"uuid": goal}, "stamp": stamp}, "status": code} for goal, code in goals
        ]
    }


@pytest.mark.parametrize(
    ("message", "code", "samples"),
    [
        (ros2, 1, []),  # ACCEPTED
        (ros2, 2, []),  # EXECUTING
        (ros2, 3, []),  # CANCELING
        (ros2, 4, [0.0]),  # SUCCEEDED
        (ros2, 5, []),  # CANCELED
        (ros2, 6, [1.0]),  # ABORTED
        (ros1, 0, []),  # PENDING
        (ros1, 1, []),  # ACTIVE
        (ros1, 2, []),  # PREEMPTED
        (ros1, 3, [0.0]),  # SUCCEEDED
        (ros1, 4, [1.0]),  # ABORTED
        (ros1, 5, [1.0]),  # REJECTED
        (ros1, 6, []),  # PREEMPTING
        (ros1, 7, []),  # RECALLING
        (ros1, 8, []),  # RECALLED
        (ros1, 9, [1.0]),  # LOST
    ],
)
def test_a_goal_counts_by_the_state_in_which_it_ended(message: Any, code: int, samples: list[float]) -> None:
    goals = Goals()
    assert goals.take(message([])) == []
    assert goals.take(message([("a", code)])) == samples
    assert goals.take(message([("a", code)])) == []


@pytest.mark.parametrize("message", [ros1, ros2])
def test_goals_that_had_ended_before_are_no_samples(message: Any) -> None:
    ended = 4
    goals = Goals()
    assert goals.take(message([("a", ended), ("b", 1)])) == []
    assert len(goals.take(message([("a", ended), ("b", ended)]))) == 1


@pytest.mark.parametrize(
    "message",
    [
        {"data": "ready"},
        {"status_list": 5},
        {
            "status_list": [
                5,
                None,
                {},
                {"status": 4},
                {"goal_id": 3, "status": 4},
                {"goal_id": {"id": "a"}, "status": []},
            ]
        },
        None,
        1.0,
    ],
)
def test_other_messages_have_no_goals_and_do_not_raise(message: Any) -> None:
    goals = Goals()
    goals.take(ros1([]))
    assert goals.take(message) == []


def test_a_server_that_lists_many_goals_fills_no_memory() -> None:
    goals = Goals()
    goals.take(ros1([]))
    for first in range(0, 20_000, 5000):
        assert len(goals.take(ros1([(str(first + n), 4) for n in range(5000)]))) == MOST_GOALS
    assert len(goals._ended) == MOST_GOALS


@pytest.mark.parametrize("seed", range(50))
def test_random_timelines_give_what_a_referee_counts(seed: int) -> None:
    """The referee knows each goal's life; it reads no message."""
    chance = random.Random(seed)
    message, live, ends = chance.choice(
        [
            (ros1, [0, 1, 6, 7], {3: [0.0], 4: [1.0], 5: [1.0], 9: [1.0], 2: [], 8: []}),
            (ros2, [1, 2, 3], {4: [0.0], 6: [1.0], 5: []}),
        ]
    )
    states: dict[str, int] = {}
    goals = Goals()
    for number in range(100):
        expected: list[float] = []
        for goal, code in list(states.items()):
            if code in live:
                states[goal] = chance.choice([*live, *ends])
                expected += ends.get(states[goal], [])
            elif chance.random() < 0.2:
                del states[goal]  # the server lists it no longer
        for new in range(chance.randrange(3)):
            code = states[f"{number}-{new}"] = chance.choice([*live, *ends])
            expected += ends.get(code, [])
        found = goals.take(message(list(states.items())))
        assert sorted(found) == ([] if number == 0 else sorted(expected))
