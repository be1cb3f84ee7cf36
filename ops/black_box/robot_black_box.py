"""The black box of one robot: what waits in memory, and when a recording begins and ends."""

from __future__ import annotations

import contextlib
from typing import Mapping

from ...core.judge import STATE, THRESHOLDS, TICKS, SavedMonitor, SavedSignal, thresholds_tree
from ...core.nodes import AlertSystem
from ...core.nodes.node import DIAGNOSTICS, base_name
from ...core.nodes.outlets import Event, alert_message, array_message
from ...core.port import Middleware, Severity
from ...core.values import ARRAY_TYPE, STATUS_TYPE, ConfigError, Level, MessageError, ServiceError, Transition
from ...core.values import Message as Mapped
from ...runtime.threads import StepThread
from .black_box import PART, BlackBox, Recording
from .capture import Capture, is_pattern
from .ring import RobotRing

_CHECK_PERIOD_S = 1.0
_TOPICS_PERIOD_S = 5.0
_TICK_TYPE = "std_msgs/Empty"
_SEGMENTS = 6  # in `before_s`
_LONGEST_SEGMENT_S = 5.0


class RobotBlackBox:
    """Records one robot. All methods are called with its node's lock, except `of_alert`, which may be without."""

    def __init__(self, box: BlackBox, middleware: Middleware, robot: str, open_files: Mapping[str, str]) -> None:
        """Subscribes to nothing yet: `attach`. `open_files` are those of alerts that are still open, by signal."""
        self.robot = robot
        self._box = box
        self._middleware = middleware
        self._ring = RobotRing(box.ring, box.settings.before_s)
        self._segment_s = max(_CHECK_PERIOD_S, min(_LONGEST_SEGMENT_S, box.settings.before_s / _SEGMENTS))
        self._topics = {
            type_name: middleware.advertise(topic, type_name)
            for topic, type_name in (("alerts", STATUS_TYPE), (DIAGNOSTICS, ARRAY_TYPE))
        }
        self._topics[_TICK_TYPE] = TICKS
        self._capture = Capture(middleware, box.settings.topics, self._ring.add, self._topics.values())
        self._topics_thread = StepThread("black box topics", self._look_for_topics, lambda error: None)
        self._alert_system: AlertSystem | None = None
        self._states: dict[str, tuple[float | None, SavedSignal]] = {}
        """Of each signal: since when it is at rest, and its state when the latest segment began."""
        self._recording: Recording | None = None
        self._open = box.open_files[robot] = dict(open_files)

    def attach(self, alert_system: AlertSystem) -> None:
        """Begins to record what the robot's alert_system watches."""
        self._alert_system = alert_system
        alert_system.outlets.add("black box", self._note)
        if not self._capture.is_simulated:
            alert_system.on_tick.append(self._note_tick)
        self._check(self._middleware.now_s())
        self._middleware.create_timer(_CHECK_PERIOD_S, self._check, steady=True)
        if any(map(is_pattern, self._box.settings.topics)):
            self._topics_thread.start()

    def of_alert(self, transition: Transition) -> str:
        """Returns the name of the file that records a transition, which begins with it or goes on; empty if none does.

        Call it before the transition is stored and announced. Never raises.
        """
        signal, level = transition.signal, transition.to_level
        try:
            if level is Level.OK:
                self._open.pop(signal, None)
                return ""
            if transition.repeat:
                return self._open.get(signal, "")
            if level.severity < self._box.settings.min_level.severity:
                return ""
            name = self._begin_or_continue(transition)
            if name:
                self._open[signal] = name
            return name
        except Exception as error:
            self._middleware.faults.report(PART, f"{type(error).__name__}: {error}")
            return ""

    @property
    def reach_s(self) -> float:
        """How far its messages in memory reach back, in s."""
        return self._ring.reach_s(self._middleware.steady_s())

    def close(self) -> None:
        """Ends the recording after what has come."""
        self._topics_thread.close()
        self._end_recording()
        self._capture.close()
        self._ring.close()
        self._box.open_files.pop(self.robot, None)

    def _begin_or_continue(self, transition: Transition) -> str:
        steady_s, after_s = self._middleware.steady_s(), self._box.settings.after_s
        recording = self._recording
        if recording is not None and not recording.is_over:
            recording.end_s = steady_s + after_s
            return recording.name
        self._end_recording()
        if self._ring.current is None or self._alert_system is None:
            return ""
        reader, offset_s = self._ring.reader(), self._box.wall_time_s() - steady_s
        config, topics = self._alert_system.configuration, self._capture.resolved

        def attachments() -> Mapping[str, str]:
            import yaml

            saved = SavedMonitor(self.robot, reader.first.begin_s, reader.first.states)
            tree = thresholds_tree(config, self.robot, topics, use_sim_time=self._capture.is_simulated)
            thresholds: str = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)
            return {THRESHOLDS: thresholds, STATE: saved.to_json(offset_s)}

        recording = self._recording = Recording(
            name=self._box.new_name(self.robot, transition.signal),
            metadata={"robot": self.robot, "alert": transition.text},
            reader=reader,
            offset_s=offset_s,
            attachments=attachments,
            profile=self._middleware.serialize(STATUS_TYPE, {})[1].profile,  # empty unless it is native, as the topics
            end_s=steady_s + after_s,
        )
        self._box.begin(recording)
        return recording.name

    def _end_recording(self) -> None:
        if self._recording is not None:
            self._ring.end_reader()
            self._recording = None
            self._box.wake()

    def _check(self, now_s: float) -> None:
        """Runs once a second."""
        assert self._alert_system is not None
        steady_s = self._middleware.steady_s()
        self._capture.follow(self._alert_system.configuration)
        current = self._ring.current
        if current is None or steady_s - current.begin_s >= self._segment_s - _CHECK_PERIOD_S / 2.0:
            self._begin_segment(now_s, steady_s)
        recording = self._recording
        if recording is None:
            return
        statuses = self._alert_system.announcements.statuses(self._middleware.now_s())
        self._record(ARRAY_TYPE, array_message(statuses, base_name(self._middleware)), steady_s)
        if recording.is_over or steady_s >= recording.end_s:
            self._end_recording()

    def _begin_segment(self, now_s: float, steady_s: float) -> None:
        """Saves the states of the signals. Those at rest have not changed."""
        assert self._alert_system is not None
        monitor, before, changed = self._alert_system.monitor, self._states, 0
        self._states = {}
        for name in monitor.saved_signals():
            at_rest_since_s = monitor.at_rest_since_s(name)
            known_s, state = before.get(name, (None, None))
            if state is None or at_rest_since_s is None or at_rest_since_s != known_s:
                state = monitor.snapshot(name, self._middleware.now_s(), steady_s)
                changed += 1
            self._states[name] = at_rest_since_s, state
        states = {name: state for name, (_, state) in self._states.items()}
        self._ring.begin_segment(steady_s, states, changed, self._capture.quiet(steady_s))

    def _note(self, event: Event) -> None:
        """Records what the monitor announces."""
        if isinstance(event, Transition) and self._alert_system is not None:
            steady_s, node = self._middleware.steady_s(), base_name(self._middleware)
            silence = self._alert_system.silence_of(event.signal)
            self._record(STATUS_TYPE, alert_message(event, node, silence), steady_s)
            self._record(ARRAY_TYPE, array_message([event.status], node), steady_s)
            if self._recording is not None:
                self._box.wake()  # not before its announcement: the thread competes for the processor

    def _note_tick(self, now_s: float) -> None:
        """Records a tick, at its time."""
        self._record(_TICK_TYPE, {}, now_s)

    def _record(self, type_name: str, message: Mapped, steady_s: float) -> None:
        try:
            data, raw_format = self._middleware.serialize(type_name, message)
        except (ConfigError, MessageError) as error:
            self._middleware.log(Severity.WARN, f"black box: {self._topics[type_name]} is not recorded: {error}")
            return
        self._ring.add((steady_s, self._topics[type_name], raw_format, data))

    def _look_for_topics(self) -> float:
        """Looks for the topics that patterns select, in a thread; returns the time until the next look, in s."""
        with contextlib.suppress(ServiceError, RuntimeError):  # it does not answer, or its topics are changing
            self._capture.topic_types = self._middleware.topic_types()
        return _TOPICS_PERIOD_S
