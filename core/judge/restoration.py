"""The saved states of an earlier run, until the first call of a monitor. See docs/rules.md, "After a restart"."""

from __future__ import annotations

from typing import Dict, List, Mapping, NamedTuple, Union

from ..config.monitor_config import MonitorConfig
from ..config.signal_config import LINK, LINK_CONFIG, template_name
from ..values.errors import ConfigError
from ..values.formatting import printable
from ..values.model import Changes
from .element_signals import ElementSignals, config_of, unconfigured
from .saved_state import Downtime, SavedSignal, SavedState, UnusableStateError, without_latch
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
        watched: Dict[str, Union[SignalMonitor, ElementSignals]],
        sources: Sources,
        changes: Changes,
    ) -> None:
        """Restores each source, and each signal into `watched` or its template there; what is not watched ends.

        `changes` receives the transitions, with a notice for each state that cannot be used.
        """
        unusable: List[str] = []
        of_sources: Dict[str, SavedSignal] = {}
        for name, saved in self.states.items():
            try:
                if is_source(name):
                    changes.add(sources.restore(name, saved, now_s, self.downtime))
                    of_sources[name] = saved
                    continue
                own = LINK_CONFIG if name == LINK else config_of(name, config.signals)
                signal = SignalMonitor(own or unconfigured(name), robot, now_s)
                signal.exchange(SavedState(now_s, saved, self.downtime))
            except (UnusableStateError, ConfigError) as error:
                shown = printable(str(name))[:80]
                unusable.append(f"{shown}: starts without its saved state: {printable(str(error))}")
                continue
            template = watched.get(template_name(name))
            if own is None or (isinstance(template, ElementSignals) and not template.restore(name, signal)):
                changes.add(signal.end(now_s))
            elif not isinstance(template, ElementSignals):
                watched[name] = signal
        sources.relate(of_sources, now_s, changes)
        more = len(unusable) - _MOST_NOTICES
        rest = [f"... and {more} more saved states"] if more > 0 else []
        changes.notices = (*unusable[:_MOST_NOTICES], *rest)
