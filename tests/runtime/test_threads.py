"""Threads that hang delay neither the loop nor the end of the process."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from pathlib import Path
from queue import Queue

import pytest

from robot_health_monitor.core.values.errors import ServiceError
from robot_health_monitor.runtime.threads import DetachedCalls, MonotonicEvent, StepThread

ROOT = str(Path(__file__).resolve().parents[2])


def test_nodes_import_only_what_they_use() -> None:
    """asyncio would take 2 MB in each node of ROS; sockets, and what reads this machine, another megabyte."""
    program = """
import sys
import robot_health_monitor.cli.executables, robot_health_monitor.runtime.threads
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.nodes import Aggregator, AlertSystem, BatterySensor

bus = LocalBus()
signals = {"battery_level": {"warn_below": 20.0}}
AlertSystem(bus.node("alert_system", parameters={"signals": signals}))
Aggregator(bus.node("aggregator"))
BatterySensor(bus.node("battery_sensor"))
bus.run_until(3.0)
unused = {"asyncio", "socket", "robot_health_monitor.core.sensors.catalogue", "sqlite3", "mcap", "aiohttp"}
print(sorted(unused & sys.modules.keys()))
"""
    ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (ended.stdout, ended.stderr) == ("[]\n", "")


def test_a_detached_call_that_hangs_keeps_its_thread_and_others_share_one() -> None:
    calls = DetachedCalls("test", most_threads=2, patience_s=30.0)
    names: list[int] = []
    for _ in range(3):
        assert calls(lambda: names.append(threading.get_ident()))
    assert len(set(names)) == 1
    began, hangs, patient = threading.Event(), threading.Event(), calls._patience_s
    calls._patience_s = 0.0
    assert not calls(lambda: (began.set(), assert_set(hangs)))
    assert began.wait(DEADLINE_S)  # in the first thread: the second one might take it from the queue
    calls._patience_s = patient
    assert calls(lambda: names.append(threading.get_ident()))
    assert len(set(names)) == 2
    calls._patience_s = 0.0
    other = threading.Event()
    assert not calls(lambda: assert_set(other))
    with pytest.raises(ServiceError, match=r"^2 sources do not answer: no thread is left$"):
        calls(lambda: None)
    hangs.set()
    other.set()
    calls.close()


def assert_set(event: threading.Event) -> None:
    assert event.wait(30.0)


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
    errors: list[Exception] = []
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
    steps: list[int] = []
    thread = StepThread("test", lambda: steps.append(1) or FOREVER_S, lambda error: None)
    thread.close()
    thread.start()
    thread.join(DEADLINE_S)
    assert steps == []


def pipes() -> set[str]:
    """Returns the pipes that this process has open, by their inodes: those of other tests may close at any time."""
    targets = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # the folder's own, or one that another thread has closed
            targets.add(os.readlink(descriptor))
    return {target for target in targets if target.startswith("pipe:")}


def test_a_thread_that_has_ended_holds_no_descriptors() -> None:
    before = pipes()
    threads = [StepThread("test", lambda: FOREVER_S, lambda error: None) for _ in range(20)]
    for thread in threads:
        thread.start()
    added = pipes() - before
    assert len(added) == 20
    for thread in threads:
        thread.close()
        thread.join(DEADLINE_S)
        thread.wake()
        thread.close()
    assert not added & pipes()


def test_an_event_ends_a_wait_from_another_thread_and_can_be_used_again() -> None:
    event = MonotonicEvent()
    assert not event.wait(0.0)
    assert not event.wait(-1.0)
    for _ in range(3):
        thread = threading.Thread(target=event.set)
        thread.start()
        assert event.wait(float("inf"))
        thread.join()
        assert event.is_set()
        event.set()
        assert event.wait(0.0)
        event.clear()
        event.clear()
        assert not event.is_set()
        assert not event.wait(0.001)


def test_a_thread_waits_by_the_monotonic_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """On Python 3.8, a clock that is set back lengthens every timed wait of `threading`."""
    steps: Queue[int] = Queue()

    timed: list[object] = []
    wait = threading.Condition.wait

    def note(self: threading.Condition, timeout: float | None = None) -> bool:
        if timeout is not None and threading.current_thread().name == "steps":
            timed.append(timeout)
        return wait(self, timeout)

    monkeypatch.setattr(threading.Condition, "wait", note)
    thread = StepThread("steps", lambda: steps.put(1) or 0.001, lambda error: None)
    thread.start()
    assert [steps.get(timeout=20.0) for _ in range(3)] == [1, 1, 1]
    assert timed == []
    thread.close()
    thread.join(20.0)
