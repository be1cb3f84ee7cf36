"""The saved states of an earlier run, until the first call of a monitor. See docs/rules.md, "After a restart"."""

from __future__ import annotations

from typing import Dict, List, Mapping, NamedTuple, Tuple

from ..config.monitor_config import MonitorConfig
from ..config.signal_config import LINK, LINK_CONFIG, template_name
from ..values.errors import ConfigError
from ..values.formatting import printable
from ..values.model import Changes
from .element_signals import ElementSignals, config_of, unconfigured
from .saved_state import Downtime, SavedSignal, UnusableStateError, without_latch
from .signal_monitor import SignalMonitor
from .sources import Sources, is_source

_MOST_NOTICES = 10


class Restoration(NamedTuple):
    """What a monitor continues from."""

    states: Mapping[str, SavedSignal]
    """The snapshots of the earlier run, by the names of the signals."""
    downtime: Downtime
    """The time in which nothing was watched."""

    def without_latches(self) -> Restoration:
        """Returns it with every latch cleared."""
        return self._replace(states={name: without_latch(saved) for name, saved in self.states.items()})

    def restore(
        self,
        config: MonitorConfig,
        robot: str,
        now_s: float,
        signals: Dict[str, SignalMonitor],
        templates: Mapping[str, ElementSignals],
    ) -> Changes:
        """Restores each signal into `signals` or its template; one that is no longer watched ends.

        Returns the transitions, with a notice for each state that cannot be used.
        """
        changes, unusable = Changes(), []
        for name, saved in self.states.items():
            if is_source(name):
                continue
            try:
                own = LINK_CONFIG if name == LINK else config_of(name, config.signals)
                signal = SignalMonitor(own or unconfigured(name), robot, now_s)
                signal.restore(saved, now_s, self.downtime)
            except (UnusableStateError, ConfigError) as error:
                unusable.append(_unusable(name, error))
                continue
            template = templates.get(template_name(name))
            if own is None or (template is not None and not template.restore(name, signal)):
                changes.add(signal.end(now_s))
            elif template is None:
                signals[name] = signal
        changes.notices = _first(unusable)
        return changes

    def restore_sources(self, sources: Sources, now_s: float, changes: Changes) -> None:
        """Restores each source; call after `restore`, whose transitions and notices `changes` has."""
        restored: Dict[str, SavedSignal] = {}
        for name, saved in self.states.items():
            if is_source(name):
                try:
                    changes.add(sources.restore(name, saved, now_s, self.downtime))
                    restored[name] = saved
                except UnusableStateError as error:
                    changes.notices = _first([*changes.notices, _unusable(name, error)])
        sources.relate(restored, now_s, changes)


def _unusable(name: str, error: Exception) -> str:
    return f"{printable(str(name))[:80]}: starts without its saved state: {printable(str(error))}"


def _first(texts: List[str]) -> Tuple[str, ...]:
    more = len(texts) - _MOST_NOTICES
    return (*texts[:_MOST_NOTICES], f"... and {more} more saved states") if more > 0 else tuple(texts)
