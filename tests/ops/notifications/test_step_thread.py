"""A thread that repeats a step."""

from __future__ import annotations

import threading
from queue import Queue
from typing import List

from robot_health_monitor.ops.notifications.step_thread import StepThread

DEADLINE_S = 30.0
FOREVER_S = 3600.0


def test_a_step_is_repeated_after_the_wait_that_it_returns_or_when_woken() -> None:
    steps: Queue[int] = Queue()
    waits = iter([0.0, 0.0, FOREVER_S, FOREVER_S])

    def step() -> float:
        steps.put(1)
        return next(waits)

    thread = StepThread("test", step, lambda error: None)
    thread.start()
    for _ in range(3):
        steps.get(timeout=DEADLINE_S)
    thread.wake()
    steps.get(timeout=DEADLINE_S)
    thread.close()
    thread.join(DEADLINE_S)
    assert steps.empty()


def test_an_exception_is_reported_and_the_thread_goes_on() -> None:
    errors: List[Exception] = []
    went_on = threading.Event()

    def step() -> float:
        if not errors:
            raise ValueError("broken")
        went_on.set()
        return FOREVER_S

    thread = StepThread("test", step, lambda error: (errors.append(error), thread.wake()))
    thread.start()
    assert went_on.wait(DEADLINE_S)
    thread.close()
    thread.join(DEADLINE_S)
    assert [str(error) for error in errors] == ["broken"]


def test_a_thread_that_is_closed_before_its_first_step_makes_none() -> None:
    steps: List[int] = []
    thread = StepThread("test", lambda: steps.append(1) or FOREVER_S, lambda error: None)
    thread.close()
    thread.start()
    thread.join(DEADLINE_S)
    assert steps == []
