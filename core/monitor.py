"""The monitor of one robot: samples and time in, transitions and reports out.

It has no clock: every call says what time it is. It raises nothing for any sample and any time.
"""

from __future__ import annotations

from typing import Dict, List, Optional

from .config import CONDITIONS, MonitorConfig, read_signal
from .formatting import printable
from .model import Changes, Level, Report, Sample, Status
from .signal_monitor import LINK, SignalMonitor

_LARGEST = 1.7976931348623157e308

LINK_CONFIG = read_signal(
    LINK, {"valid_min": 0.0, "valid_max": 1.0, "error_below": 1.0, "stale_after_s": 0.0, "startup_grace_s": 0.0}
)
"""How the link to a robot is judged: down is an ERROR at once, and only samples say so."""


class Monitor:
    """Watches the signals of one robot.

    A sample of the signal `link` (1.0: the robot can be reached, 0.0: it cannot) need not be configured. While the
    link is down, the other signals stand still: one alert says it all.
    """

    def __init__(self, config: MonitorConfig, robot: str = "") -> None:
        """Makes a monitor that has seen nothing.

        Args:
            config: what to watch, from `load_config`.
            robot: the robot's name, in place of the configuration's `robot_name`.
        """
        self.robot = robot or config.robot_name
        self.config = config
        self._signals: Dict[str, SignalMonitor] = {}
        # NaN is not smaller than any time, so that the first call goes the careful way.
        self._now_s = float("nan")
        self._followers: Dict[str, List[SignalMonitor]] = {}
        self._all_followers: List[SignalMonitor] = []
        self._link_down = False
        self._link_cause = ""

    def observe(self, sample: Sample) -> Changes:
        """Takes a sample.

        Args:
            sample: one measurement; a signal that is not configured is ignored.

        Returns:
            The transitions that it causes: at most one of its own signal, and of those that follow it by a condition.
        """
        name, value, now_s = sample
        changes = Changes()
        if not self._now_s <= now_s <= _LARGEST:
            now_s = self._take_odd_time(now_s, changes)
        self._now_s = now_s
        signal = self._signals.get(name)
        if signal is None:
            if name != LINK:
                return changes
            signal = self._signals[LINK] = SignalMonitor(LINK_CONFIG, self.robot, now_s)
        if name == LINK:
            signal.cause = self._link_cause
        transition = signal.observe(value, now_s)
        if name == LINK:
            self._follow_link(now_s)
        elif self._link_down:
            signal.inhibit(now_s)
        followers = self._followers.get(name)
        if transition is not None:
            changes.append(transition)
        if followers is not None:
            followed = [follower.follow(self.fresh_value, now_s) for follower in followers]
            changes.extend(transition for transition in followed if transition is not None)
        return changes

    def set_link(self, up: bool, cause: str, now_s: float) -> Changes:
        """Takes the state of the link to the robot: a sample of the signal `link`, with a cause.

        Args:
            up: whether the robot can be reached.
            cause: why it cannot, for example `connection refused`; ignored while `up`.
            now_s: the time in seconds.

        Returns:
            The transitions that it causes.
        """
        self._link_cause = "" if up else printable(cause)
        return self.observe(Sample(LINK, 1.0 if up else 0.0, now_s))

    def tick(self, now_s: float) -> Changes:
        """Lets time pass.

        Args:
            now_s: the time in seconds.

        Returns:
            The transitions that it causes, in the order of the configuration.
        """
        changes = Changes()
        if not self._now_s <= now_s <= _LARGEST:
            now_s = self._take_odd_time(now_s, changes)
        self._now_s = now_s
        ticked = [signal.tick(now_s) for name, signal in self._signals.items() if name == LINK or not self._link_down]
        for follower in self._all_followers:
            ticked.append(follower.follow(self.fresh_value, now_s))
        changes.extend(transition for transition in ticked if transition is not None)
        return changes

    def report(self, now_s: float) -> Report:
        """Returns the whole state as of the last `observe` or `tick`; ages are counted up to `now_s`, in seconds."""
        signals = self._signals
        if not signals:
            now_s = now_s if -_LARGEST <= now_s <= _LARGEST else 0.0
            signals = {name: SignalMonitor(signal, self.robot, now_s) for name, signal in self.config.signals.items()}
        elif not self._now_s <= now_s <= _LARGEST:
            now_s = self._now_s
        statuses = {name: signal.status(now_s) for name, signal in signals.items()}
        overall = Level.worst(status.level for status in statuses.values())
        return Report(overall, statuses, now_s, self.robot)

    def status(self, signal: str, now_s: float) -> Optional[Status]:
        """Returns what `report` says of one signal; None for one that nothing is known of."""
        known = self._signals.get(signal)
        if known is None:
            return None
        return known.status(now_s if self._now_s <= now_s <= _LARGEST else self._now_s)

    def fresh_value(self, signal: str) -> Optional[float]:
        """Returns the value of a signal's latest sample; None while there is none, it is bad or it is stale."""
        known = self._signals.get(signal)
        return None if known is None else known.fresh_value

    def reset(self) -> Changes:
        """Clears every latch.

        Returns:
            The transitions that it causes, in the order of the configuration, at the time of the last call.
        """
        transitions = [signal.reset(self._now_s) for signal in self._signals.values()]
        return Changes(transition for transition in transitions if transition is not None)

    def configure(self, config: MonitorConfig) -> Changes:
        """Takes a new configuration; signals whose own configuration is the same are not disturbed.

        Args:
            config: what to watch from now on. Signals that are no longer in it are forgotten.

        Returns:
            The transitions that the new bounds cause, at the time of the last call.
        """
        self.config = config
        if not self._signals:
            return Changes()
        transitions = []
        signals: Dict[str, SignalMonitor] = {}
        for name, signal_config in config.signals.items():
            known = self._signals.get(name)
            if known is None:
                known = SignalMonitor(signal_config, self.robot, self._now_s)
            elif known.config != signal_config:
                transitions.append(known.configure(signal_config, self._now_s))
            signals[name] = known
        if LINK in self._signals:
            signals.setdefault(LINK, self._signals[LINK])
        self._signals = signals
        self._inhibit_all(self._now_s)
        self._find_followers()
        transitions.extend(follower.follow(self.fresh_value, self._now_s) for follower in self._all_followers)
        return Changes(transition for transition in transitions if transition is not None)

    def _take_odd_time(self, now_s: float, changes: Changes) -> float:
        """Returns the time to go on with: the first one, one that went back, or the last one for no time at all."""
        if not -_LARGEST <= now_s <= _LARGEST:
            now_s = self._now_s if self._signals else 0.0
        if not self._signals:
            self._signals = {
                name: SignalMonitor(signal, self.robot, now_s) for name, signal in self.config.signals.items()
            }
            self._find_followers()
        elif now_s < self._now_s:
            went_back_s = self._now_s - now_s
            changes.notices = (f"time went back by {went_back_s:.3f} s: windows, pending timers and staleness restart",)
            for signal in self._signals.values():
                signal.restart_time(now_s)
            self._inhibit_all(now_s)
        return float(now_s)

    def _find_followers(self) -> None:
        """Notes which signals have a condition on which other one."""
        self._followers = {}
        self._all_followers = []
        for signal in self._signals.values():
            followed = {getattr(signal.config, key).signal for key in CONDITIONS if getattr(signal.config, key)}
            if followed:
                self._all_followers.append(signal)
            for name in followed:
                self._followers.setdefault(name, []).append(signal)

    def _follow_link(self, now_s: float) -> None:
        reached = self.fresh_value(LINK)
        down = reached is None or reached < 1.0
        if down is self._link_down:
            return
        self._link_down = down
        for name, signal in self._signals.items():
            if name != LINK:
                if down:
                    signal.inhibit(now_s)
                else:
                    signal.release(now_s)

    def _inhibit_all(self, now_s: float) -> None:
        """Lets the signals that were restarted or are new stand still, too, while the link is down."""
        if self._link_down:
            for name, signal in self._signals.items():
                if name != LINK:
                    signal.inhibit(now_s)
