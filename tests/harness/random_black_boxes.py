"""Random black boxes in virtual time, replayed: the alert lines must be those that the monitor gave."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from harness.black_boxes import BOOT_S, RecordedRobot
from robot_health_monitor.core import Level


def judged(file: Path, *, sim_time: bool = False) -> list[tuple[float, Level, str]]:
    """Returns the transitions of a replay in this process: virtual time, level, and the line without `(was ...)`."""
    from robot_health_monitor.core.config.monitor_config import find_section
    from robot_health_monitor.core.config.yaml_file import parse_yaml
    from robot_health_monitor.core.judge.attachments import STATE, THRESHOLDS, read_saved_monitor
    from robot_health_monitor.core.values.model import Transition
    from robot_health_monitor.recordings.judging import Judge, JudgedEvent
    from robot_health_monitor.recordings.middleware import Player
    from robot_health_monitor.recordings.reading import Recordings

    found: list[tuple[float, Level, str]] = []

    def note(event: JudgedEvent) -> None:
        if isinstance(event.event, Transition):
            found.append((event.wall_s - BOOT_S, event.event.to_level, without_past(event.event.text)))

    with Recordings([str(file)]) as recordings:
        saved = read_saved_monitor(recordings.attachments[STATE])
        section = find_section(parse_yaml(recordings.attachments[THRESHOLDS], "x").tree, "alert_system")
        judge = Judge(Player(recordings, use_sim_time=sim_time, begin_ns=round(saved.time_s * 1e9)), note)
        judge.add("x", section.tree, saved)
        judge.run()
    return found


def without_past(text: str) -> str:
    return text.partition(" (was ")[0]


def random_signal(choices: random.Random) -> dict[str, Any]:
    """Returns a signal with a statistic, durations and a bound that a random walk around 50 crosses now and then."""
    signal: dict[str, Any] = {"type": "std_msgs/Float32", "unit": "%", "stale_after_s": choices.choice([1.0, 3.0, 5.0])}
    statistic = choices.choice(["last", "last", "mean", "min", "max", "frequency_hz", "stddev"])
    signal["statistic"] = statistic
    if statistic == "frequency_hz":
        signal.update(field="", warn_below=8.0, error_below=3.0, window_s=5.0)
        del signal["unit"]
    elif statistic == "stddev":
        signal.update(warn_above=6.0, window_s=10.0)
    else:
        signal.update(warn_below=40.0, error_below=30.0, warn_above=60.0, hysteresis=choices.choice([0.0, 2.0]))
        signal.update(window_s=choices.choice([5.0, 10.0]))
    signal["for_s"] = choices.choice([0.0, 0.0, 1.0, 5.0])
    signal["keep_firing_for_s"] = choices.choice([0.0, 3.0])
    if choices.random() < 0.2:
        signal["flap_detection"] = True
    return signal


def check_random_black_box(tmp_path: Path, seed: int) -> None:
    """Asserts that the replay of the files of a random robot gives the same lines, apart from `(was ...)`."""
    choices = random.Random(seed)
    names = [f"s{number}" for number in range(choices.randint(1, 3))]
    signals = {name: {**random_signal(choices), "topic": name} for name in names}
    robot = RecordedRobot(tmp_path, signals, before_s=30.0, after_s=10.0)
    values = dict.fromkeys(names, 50.0)
    silent_until_s = dict.fromkeys(names, 0.0)
    due_s = dict.fromkeys(names, robot.bus.now_s)
    end_s = robot.bus.now_s + 150.0
    while robot.bus.now_s < end_s:
        name = min(names, key=due_s.__getitem__)
        robot.bus.run_until(due_s[name])
        if robot.bus.now_s >= silent_until_s[name]:
            values[name] += choices.gauss((50.0 - values[name]) * 0.01, 1.5)
            robot.publish(name, choices.choice([values[name]] * 300 + [float("nan")]))
            if choices.random() < 0.003:
                silent_until_s[name] = robot.bus.now_s + choices.uniform(0.5, 9.0)
        due_s[name] += choices.uniform(0.05, 0.15)
    robot.wait(40.0)
    files = robot.files()
    assert files
    for file in files:
        began = [each for each in robot.transitions if each.black_box == file.name]
        expected = [(each.now_s, each.to_level, without_past(each.text)) for each in began]
        found = [each for each in judged(file) if each[1] is not Level.OK and each[0] >= expected[0][0] - 1e-3]
        assert [each[1:] for each in found] == [each[1:] for each in expected]
        assert [each[0] for each in found] == pytest.approx([each[0] for each in expected], abs=1e-3)
    robot.close()
