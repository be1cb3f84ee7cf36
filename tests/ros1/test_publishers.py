"""Questions to a master, which may be down or hang, are answered in a thread."""

from __future__ import annotations

import socket
import threading
from typing import Any, Dict, List, Optional

import pytest


class Answers:
    """What was answered, by topic."""

    def __init__(self, expected: int) -> None:
        self.texts: Dict[str, Optional[str]] = {}
        self.threads: List[threading.Thread] = []
        self._expected = expected
        self._complete = threading.Event()

    def of(self, topic: str) -> Any:
        def answer(text: Optional[str]) -> None:
            self.texts[topic] = text
            self.threads.append(threading.current_thread())
            if len(self.texts) == self._expected:
                self._complete.set()

        return answer

    def wait(self) -> None:
        assert self._complete.wait(30.0), self.texts


def lookup(uri: str, monkeypatch: pytest.MonkeyPatch, timeout_s: float = 10.0) -> Any:
    from robot_health_monitor.ros1.master import Master
    from robot_health_monitor.ros1.publishers import PublisherLookup

    monkeypatch.setenv("ROS_MASTER_URI", uri)
    return PublisherLookup(Master("/tests", timeout_s), lambda: {"/rosout_agg", "/rosout"})


def test_each_question_is_answered_by_the_master_in_another_thread(
    master: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    publishers = lookup(master.uri, monkeypatch)
    for _ in range(2):  # the second time with a new thread
        answers = Answers(4)
        publishers.look_up("/none", "std_msgs/Float32", answers.of("/none"))
        publishers.look_up("/rosout_agg", "rosgraph_msgs/Log", answers.of("/rosout_agg"))
        publishers.look_up("/rosout_agg", "std_msgs/Float32", answers.of("wrong type"))
        publishers.look_up("/rosout_ag", "", answers.of("own topic"))
        answers.wait()
        assert answers.texts == {
            "/none": "no publisher on /none",
            "/rosout_agg": None,
            "wrong type": "/rosout_agg is published as rosgraph_msgs/Log, configured as std_msgs/Float32",
            "own topic": "no publisher on /rosout_ag",
        }
        for thread in answers.threads:
            assert thread is not threading.current_thread()
            thread.join(30.0)


def test_a_master_that_hangs_gives_no_reason_and_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as hanging:
        hanging.bind(("127.0.0.1", 0))
        hanging.listen()
        publishers = lookup(f"http://127.0.0.1:{hanging.getsockname()[1]}", monkeypatch, timeout_s=0.2)
        answers = Answers(50)
        for number in range(50):
            publishers.look_up(f"/topic_{number}", "std_msgs/Float32", answers.of(f"/topic_{number}"))
        answers.wait()
        assert set(answers.texts.values()) == {None}
        assert len(set(answers.threads)) == 1


def test_a_master_that_is_down_gives_no_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = Answers(1)
    lookup("http://127.0.0.1:9", monkeypatch).look_up("/battery", "std_msgs/Float32", answers.of("/battery"))
    answers.wait()
    assert answers.texts == {"/battery": None}
