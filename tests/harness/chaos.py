"""Chaos: a monitor that is watched from outside while faults occur at random moments.

The robot is a process (`chaos_peers/`) that publishes one battery level again and again and reports every alert that it
receives. Repeating makes the expectation exact although samples may be lost: one alert per change of the level, no
matter when a fault occurs.
"""

from __future__ import annotations

import contextlib
import json
import random
import signal
import subprocess
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any, Callable, Mapping, NamedTuple, Sequence

from harness.line_process import LineProcess
from harness.separate_network import SeparateNetwork

PEERS = Path(__file__).parent / "chaos_peers"
VALUES = {"OK": 50.0, "WARN": 15.0, "ERROR": 5.0}
"""A battery level in % for each level."""
SIGNALS = {"battery_level": {"unit": "%", "warn_below": 20.0, "error_below": 10.0, "stale_after_s": 0.0}}
THRESHOLDS = f"alert_system: {{ros__parameters: {{signals: {json.dumps(SIGNALS)}}}}}\n"
DEADLINE_S = 30.0
"""Longest wait on a busy machine: until a process has started, until the alert after the end of a fault."""


class Robot:
    """A peer process."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str]) -> None:
        self.alerts: list[str] = []
        """The levels of battery_level's alerts, in the order of arrival."""
        self._periods = 0
        self._is_connected = False
        self._changed = threading.Condition()
        self._process = subprocess.Popen(
            list(command), env=dict(environment), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def publish(self, value: float) -> None:
        """Publishes this value from now on, 20 times per second."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{value}\n")

    def wait_until_connected(self) -> None:
        """Waits until the robot is connected with the monitor in both directions."""
        latest = self._periods + 1  # the line of one period may be on its way
        assert self._wait_until(lambda: self._is_connected and self._periods > latest), "the robot is not connected"

    def wait_until_heard(self) -> None:
        """Makes the battery low until an alert arrives: ROS counts connections that are not ready yet. Ends with OK."""
        for level in ("WARN", "OK") * int(DEADLINE_S / 2.0):
            self.publish(VALUES[level])
            if self._wait_until(lambda: bool(self.alerts), 1.0):
                break
        for level in ("ERROR", "OK"):
            self.publish(VALUES[level])
            assert self._wait_until(lambda wanted=level: self.alerts[-1:] == [wanted]), f"no alert {level}"

    def wait_for_arrivals(self) -> None:
        """Waits until the robot has handled what has reached its machine: for three of its periods."""
        latest = self._periods + 3
        assert self._wait_until(lambda: self._periods > latest), "the robot does nothing"

    def _wait_until(self, condition: Callable[[], bool], longest_s: float = DEADLINE_S) -> bool:
        with self._changed:
            return self._changed.wait_for(condition, longest_s)

    def end(self) -> None:
        self._process.kill()
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()  # type: ignore[union-attr]
        self._process.wait()
        self._reader.join(10.0)

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout:
            for line in self._process.stdout:
                word, _, rest = line.strip().partition(" ")
                with self._changed:
                    if word == "alert":
                        self.alerts.append(rest)
                    else:
                        self._is_connected = word == "connected"
                        self._periods += 1
                    self._changed.notify_all()


class Life(NamedTuple):
    """What one process of the monitor was given, and where its alerts begin."""

    wanted: list[str]
    first_alert: int


class Trial:
    """Drives the battery through levels and compares the alerts with those that the rules give."""

    def __init__(self, seed: int, alerts: list[str], publish: Callable[[float], None]) -> None:
        """Starts with a battery that is OK.

        Args:
            seed: of the random choices.
            alerts: the alerts so far; grows.
            publish: publishes a value from now on.
        """
        self.chance = random.Random(seed)
        self._alerts = alerts
        self._publish = publish
        self._level = "OK"
        self._lives = [Life([], len(alerts))]
        publish(VALUES["OK"])

    def change(self, during: Callable[[], None] = lambda: None) -> None:
        """Changes the level, lets `during` happen, and waits for the alert.

        Args:
            during: a fault and its end.
        """
        self._level = self.chance.choice([level for level in VALUES if level != self._level])
        self._lives[-1].wanted.append(self._level)
        self._publish(VALUES[self._level])
        during()
        self.wait_for_alert()

    def wait_for_alert(self) -> None:
        """Waits for the alert of the present level."""
        give_up_s = time.monotonic() + DEADLINE_S
        while not self._is_announced():
            if time.monotonic() > give_up_s:
                raise AssertionError(f"no alert {self._level} after {DEADLINE_S:g} s; there was: {self.seen()}")
            time.sleep(0.01)

    def restarted(self) -> None:
        """Notes that the process of the monitor was killed and a new one has started, with an empty state."""
        if self._level != "OK":
            self.check()
        self._lives.append(Life([] if self._level == "OK" else [self._level], len(self._alerts)))

    def pause(self, longest_s: float = 0.3, shortest_s: float = 0.0) -> None:
        """Waits for a random time, so that what follows happens at a random moment."""
        time.sleep(self.chance.uniform(shortest_s, longest_s))

    def lose(self, network: SeparateNetwork) -> None:
        """Cuts the network to the robot for a random time of up to 3 s."""
        self.pause()
        network.cut()
        self.pause(3.0)
        network.mend()

    def stop(self, process: LineProcess, longest_s: float, shortest_s: float = 0.0) -> None:
        """Stops a process for a random time."""
        self.pause()
        process.signal(signal.SIGSTOP)
        self.pause(longest_s, shortest_s)
        process.signal(signal.SIGCONT)

    def check(self) -> None:
        """Checks the alerts of the present life: each change once, in order.

        Only the last may be missing, when the process was killed before it was announced.
        """
        wanted, seen = self._lives[-1].wanted, self.seen()
        assert seen in (wanted, wanted[:-1]), f"expected {wanted}, got {seen}"

    def finish(self) -> None:
        """Checks that every change was announced once, also when some more time has passed."""
        self.wait_for_alert()
        for _ in range(2):
            self.change()
        time.sleep(0.3)  # that something does not happen can only be seen by waiting
        wanted, seen = self._lives[-1].wanted, self.seen()
        assert seen == wanted, f"expected {wanted}, got {seen}"

    def seen(self) -> list[str]:
        """Returns the alerts of the present life."""
        return list(self._alerts[self._lives[-1].first_alert :])

    def _is_announced(self) -> bool:
        return len(self.seen()) >= len(self._lives[-1].wanted)


def check_stderr(lines: Sequence[str]) -> None:
    """Checks that a process wrote single lines only on stderr: no traceback."""
    for line in lines:
        assert line.strip() == line and line and len(line) < 500, f"{line!r} in:\n" + "\n".join(lines)
        assert not line.startswith(("Traceback", "Exception ")), "\n".join(lines)


def trial_of(robot: Robot, seed: int) -> Trial:
    """Returns a trial in which a robot, once it is connected, publishes and receives the alerts."""
    robot.wait_until_connected()
    robot.wait_until_heard()
    return Trial(seed, robot.alerts, robot.publish)


def kill_and_stop(start: Callable[[], LineProcess], new_robot: Callable[[], Robot], seed: int, rounds: int) -> None:
    """Kills and stops a node of ROS at random moments, and checks its alerts."""
    process, robot = start(), new_robot()
    trial = trial_of(robot, seed)
    for _ in range(rounds):
        trial.change(trial.pause)
        trial.change(partial(trial.stop, process, 3.0, 0.2))
        trial.pause()
        kill(process)
        robot.wait_for_arrivals()
        trial.check()
        robot.end()
        # `alerts` is not latched: the battery of the next robot is OK until it is connected.
        process, robot = start(), new_robot()
        trial = trial_of(robot, trial.chance.randrange(10**9))
    trial.finish()
    end(process)


def cut_network(trial: Trial, network: SeparateNetwork, rounds: int) -> None:
    """Cuts the network to the robot at random moments, and checks the alerts."""
    for _ in range(rounds):
        trial.change(trial.pause)
        trial.change(lambda: trial.lose(network))
    trial.finish()


def kill(process: LineProcess) -> None:
    """Ends a monitor with SIGKILL; checks its stderr."""
    process.signal(signal.SIGKILL)
    process.wait()
    check_stderr(process.errors)


def end(process: LineProcess) -> None:
    """Ends a monitor with SIGINT; checks its exit code and its stderr."""
    process.signal()
    assert process.wait() == 0, process.text
    check_stderr(process.errors)


class AlertsOfOutput:
    """The alerts in the JSON output of a process, which is read all the time."""

    def __init__(self) -> None:
        self.alerts: list[str] = []
        """The levels of battery_level's."""
        self.links: list[str] = []
        """The levels of the link's."""

    def wait_for_links(self, *levels: str) -> None:
        """Waits until the alerts of the link are these."""
        give_up_s = time.monotonic() + DEADLINE_S
        while self.links != list(levels):
            assert time.monotonic() < give_up_s, f"expected {levels}, got {self.links} after {DEADLINE_S:g} s"
            time.sleep(0.01)

    def follow(self, process: Any) -> None:
        """Takes what was read of a process, and reads it in a thread until it ends."""
        for line in process.lines:
            self._take(line.text)
        self._thread = threading.Thread(target=self._read, args=(process,), daemon=True)
        self._thread.start()

    def wait_for_end(self) -> None:
        """Waits until the process has ended and all of its output is here."""
        self._thread.join(DEADLINE_S)
        assert not self._thread.is_alive()

    def _read(self, process: LineProcess) -> None:
        try:
            process.wait_for_line(self._take, deadline_s=600.0)
        except AssertionError:
            pass  # it has ended

    def _take(self, line: str) -> bool:
        if line.startswith("{"):
            fields = json.loads(line)
            if fields["signal"] == "battery_level":
                self.alerts.append(fields["to_level"])
            elif fields["signal"] == "link":
                self.links.append(fields["to_level"])
        return False
