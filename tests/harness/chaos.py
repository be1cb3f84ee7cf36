"""Chaos: a monitor that is watched from outside while faults occur at random moments.

The robot is a process (`chaos_peers/`) that publishes one battery level again and again and reports every alert that it
receives. Repeating makes the expectation exact although samples may be lost: one alert per change of the level, no
matter when a fault occurs.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import subprocess
import threading
import time
from pathlib import Path
from typing import Any, Callable, List, Mapping, NamedTuple, Sequence

from harness.line_process import LineProcess
from harness.separate_network import SeparateNetwork

PEERS = Path(__file__).parent / "chaos_peers"
VALUES = {"OK": 50.0, "WARN": 15.0, "ERROR": 5.0}
"""A battery level in % for each level."""
SIGNALS = {"battery_level": {"unit": "%", "warn_below": 20.0, "error_below": 10.0, "stale_after_s": 0.0}}
THRESHOLDS = f"alert_system: {{ros__parameters: {{signals: {json.dumps(SIGNALS)}}}}}\n"
RECOVERY_S = 5.0
"""A monitor works again this long after a fault has ended."""
START_S = 30.0
"""A process has started by then, on a busy machine."""


def new_seed() -> int:
    """Returns the seed of CHAOS_SEED, else a random one, and prints it: pytest shows it when a test fails."""
    seed = int(os.environ.get("CHAOS_SEED") or random.SystemRandom().randrange(10**9))
    print(f"CHAOS_SEED={seed}")
    return seed


class Robot:
    """A peer process."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str]) -> None:
        self.alerts: List[str] = []
        """The levels of battery_level's alerts, in the order of arrival."""
        self._is_ready = threading.Event()
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
        self._is_ready.clear()
        assert self._is_ready.wait(START_S), "the robot is not connected with the monitor"

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
                if word == "alert":
                    self.alerts.append(rest)
                elif word == "connected":
                    self._is_ready.set()


class Life(NamedTuple):
    """What one process of the monitor was given, and where its alerts begin."""

    wanted: List[str]
    first_alert: int


class Trial:
    """Drives the battery through levels and compares the alerts with those that the rules give."""

    def __init__(self, seed: int, alerts: List[str], publish: Callable[[float], None]) -> None:
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

    def change(self, during: Callable[[], None] = lambda: None, within_s: float = RECOVERY_S) -> None:
        """Changes the level, lets `during` happen, and waits for the alert.

        Args:
            during: a fault and its end.
            within_s: longest time from the end of the fault to the alert.
        """
        self._level = self.chance.choice([level for level in VALUES if level != self._level])
        self._lives[-1].wanted.append(self._level)
        self._publish(VALUES[self._level])
        during()
        self.wait_for_alert(within_s)

    def wait_for_alert(self, within_s: float = RECOVERY_S) -> None:
        """Waits for the alert of the present level."""
        give_up_s = time.monotonic() + within_s
        while not self._is_announced():
            if time.monotonic() > give_up_s:
                raise AssertionError(f"no alert {self._level} after {within_s:g} s; there was: {self.seen()}")
            time.sleep(0.01)

    def change_to_ok_unseen(self) -> None:
        """Makes the battery OK while no monitor runs."""
        self.check()
        self._level = "OK"
        self._publish(VALUES["OK"])

    def restarted(self) -> None:
        """Notes that the process of the monitor was killed and a new one has started, with an empty state."""
        if self._level != "OK":
            self.check()
        self._lives.append(Life([] if self._level == "OK" else [self._level], len(self._alerts)))

    def pause(self, longest_s: float = 0.3) -> None:
        """Waits for a random time, so that what follows happens at a random moment."""
        time.sleep(self.chance.random() * longest_s)

    def lose(self, network: SeparateNetwork) -> None:
        """Cuts the network to the robot for a random time of up to 3 s."""
        self.pause()
        network.cut()
        self.pause(3.0)
        network.mend()

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
        time.sleep(0.3)
        wanted, seen = self._lives[-1].wanted, self.seen()
        assert seen == wanted, f"expected {wanted}, got {seen}"

    def seen(self) -> List[str]:
        """Returns the alerts of the present life."""
        return list(self._alerts[self._lives[-1].first_alert :])

    def _is_announced(self) -> bool:
        return len(self.seen()) >= len(self._lives[-1].wanted)


def check_stderr(lines: Sequence[str]) -> None:
    """Checks that a process wrote single lines only on stderr: no traceback."""
    for line in lines:
        assert line.strip() == line and line and len(line) < 500, f"{line!r} in:\n" + "\n".join(lines)
        assert not line.startswith(("Traceback", "Exception ")), "\n".join(lines)


def end(process: LineProcess) -> None:
    """Ends a monitor with SIGINT; checks its exit code and its stderr."""
    process.signal()
    assert process.wait() == 0, process.text
    check_stderr(process.errors)


class AlertsOfOutput:
    """The alerts in the JSON output of a process, which is read all the time."""

    def __init__(self) -> None:
        self.alerts: List[str] = []

    def follow(self, process: Any) -> None:
        """Takes what was read of a process, and reads it in a thread until it ends."""
        for line in process.lines:
            self._take(line.text)
        threading.Thread(target=self._read, args=(process,), daemon=True).start()

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
        return False
