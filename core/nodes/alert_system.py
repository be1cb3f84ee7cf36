"""alert_system: judges every configured signal, announces transitions, publishes its whole state."""

from __future__ import annotations

import platform
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

from ..config import DEFAULT_SIGNALS, MonitorConfig, SignalConfig, described_parameters, load_config
from ..diagnostics import ARRAY_TYPE, STATUS_TYPE, alert_message, array_message
from ..errors import ConfigError
from ..formatting import bound_text, with_unit
from ..middleware import Message, Middleware, Severity, Subscription
from ..model import Level, Sample, Transition
from ..monitor import Monitor
from ..signal_monitor import LINK
from .identity import DIAGNOSTICS, base_name, refuse_change

TRIGGER_TYPE = "std_srvs/Trigger"
TICK_PERIOD_S = 1.0

_SEVERITY_OF_LEVEL = {
    Level.OK: Severity.INFO,
    Level.WARN: Severity.WARN,
    Level.ERROR: Severity.ERROR,
    Level.STALE: Severity.WARN,
}


class AlertSystem:
    """Judges every configured signal; logs and publishes each transition once, and its whole state every second.

    A transition brings the status of its signal to /diagnostics at once.
    """

    def __init__(self, middleware: Middleware, on_transition: Optional[Callable[[Transition], None]] = None) -> None:
        """Starts watching.

        Args:
            middleware: the node's connection.
            on_transition: called with every transition, besides the log and the topics.

        Raises:
            ConfigError: the configuration cannot be used.
        """
        self._middleware = middleware
        self._on_transition = on_transition
        self._node = base_name(middleware)
        given = middleware.given_parameters()
        config = _read_monitor_config(given)
        self.monitor = Monitor(config, config.robot_name or platform.node())
        """The monitor, for whoever wants to look at it."""
        self._subscriptions: Dict[Tuple[str, str, str, str], Subscription] = {}
        middleware.declare_parameters(described_parameters(config), self._reconfigure)
        middleware.advertise("alerts", STATUS_TYPE)
        middleware.advertise(DIAGNOSTICS, ARRAY_TYPE)
        self._follow_topics(config)
        middleware.advertise_service("~reset", TRIGGER_TYPE, self._reset)
        middleware.create_timer(TICK_PERIOD_S, self._tick)
        self._report_timer = middleware.create_timer(1.0 / config.publish_rate, self._report)
        if "signals" not in given:
            middleware.log(Severity.INFO, "no signals are configured: watching the three of the defaults")
        for signal in config.signals.values():
            middleware.log(Severity.INFO, f"watching {_summary(signal)}")

    def observe(self, sample: Sample) -> None:
        """Judges a sample that does not come from a topic, such as that of the signal `link`."""
        self._announce(self.monitor.observe(sample), sample.now_s)

    def close(self) -> None:
        """Leaves the middleware."""
        self._middleware.close()

    def _follow_topics(self, config: MonitorConfig) -> None:
        """Subscribes to what is not subscribed to yet, and when all of that worked, ends what is no longer wanted."""
        wanted = {
            (name, signal.topic, signal.type, signal.field) for name, signal in config.signals.items() if name != LINK
        }
        added: Dict[Tuple[str, str, str, str], Subscription] = {}
        try:
            # Those that say most about a topic come first: what only counts its messages can then share them.
            for key in sorted(wanted - self._subscriptions.keys(), key=lambda key: (key[3] == "", key[2] == "", key)):
                name, topic, type_name, field = key
                added[key] = self._subscribe(name, topic, type_name, field)
        except ConfigError:
            for subscription in added.values():
                self._middleware.unsubscribe(subscription)
            raise
        for key in self._subscriptions.keys() - wanted:
            self._middleware.unsubscribe(self._subscriptions.pop(key))
        self._subscriptions.update(added)

    def _subscribe(self, name: str, topic: str, type_name: str, field: str) -> Subscription:
        try:
            return self._middleware.subscribe(topic, type_name, self._observer(name), field=field or None)
        except ConfigError as error:
            raise ConfigError(error.problem, ("signals", name)) from None

    def _observer(self, name: str) -> Callable[[Any, float], None]:
        take, notices, announce = self.monitor.take, self.monitor.notices, self._announce

        def callback(value: Any, now_s: float) -> None:
            transitions = take(name, value, now_s)
            if transitions or notices:
                announce(transitions, now_s)

        return callback

    def _tick(self, now_s: float) -> None:
        transitions = self.monitor.tick(now_s)
        if transitions or self.monitor.notices:
            self._announce(transitions, now_s)

    def _report(self, now_s: float) -> None:
        if self._middleware.has_listeners(DIAGNOSTICS):
            self._middleware.publish(
                DIAGNOSTICS, array_message(self.monitor.report(now_s).statuses.values(), self._node)
            )

    def _announce(self, transitions: List[Transition], now_s: float) -> None:
        for notice in self.monitor.notices:
            self._middleware.log(Severity.INFO, notice)
        self.monitor.notices.clear()
        for transition in transitions:
            self._middleware.log(_SEVERITY_OF_LEVEL[transition.to_level], transition.text)
            self._middleware.publish("alerts", alert_message(transition, self._node))
            if self._on_transition is not None:
                self._on_transition(transition)
        if transitions:
            # Only what changed: when a hundred signals come back one by one, a hundred whole reports would be too many.
            changed = dict.fromkeys(transition.signal for transition in transitions)
            statuses = [self.monitor.status(signal, now_s) for signal in changed]
            known = [status for status in statuses if status is not None]
            self._middleware.publish(DIAGNOSTICS, array_message(known, self._node))

    def _reset(self, request: Message) -> Message:
        transitions = self.monitor.reset()
        self._announce(transitions, self._middleware.now_s())
        cleared = ", ".join(transition.signal for transition in transitions) or "nothing was latched"
        return {"success": True, "message": f"reset: {cleared}"}

    def _reconfigure(self, tree: Mapping[str, Any]) -> None:
        old = self.monitor.config
        config = _read_monitor_config(tree)
        for name in ("robot_name", "rosbridge_port", "rosbridge_address", "rosbridge_token"):
            refuse_change(name, getattr(old, name), getattr(config, name))
        self._follow_topics(config)
        if config.publish_rate != old.publish_rate:
            self._report_timer.cancel()
            self._report_timer = self._middleware.create_timer(1.0 / config.publish_rate, self._report)
        self._announce(self.monitor.configure(config), self._middleware.now_s())


def _read_monitor_config(tree: Mapping[str, Any]) -> MonitorConfig:
    return load_config(tree if "signals" in tree else {**tree, "signals": DEFAULT_SIGNALS})


def _summary(signal: SignalConfig) -> str:
    bounds = [
        f"{name.replace('_', ' ').upper().replace('BELOW', 'below').replace('ABOVE', 'above')} "
        + with_unit(bound_text(bound), signal.unit)
        for name, bound in signal.bounds.items()
    ]
    return f"{signal.name} on {signal.topic}" + (f": {', '.join(bounds)}" if bounds else "")
