"""The judge: samples and time in, transitions and reports out, as docs/rules.md defines them."""

from .attachments import STATE, THRESHOLDS, TICKS, SavedMonitor, read_saved_monitor, thresholds_tree
from .continuity import MAX_EVIDENCE, Continuity, SignalHistory
from .element_signals import MOST_REFUSED, config_of, own_config
from .monitor import Monitor
from .quality import number_of
from .sample_summary import NO_SAMPLES, PERIOD_S, SampleCollector, SampleSummary
from .saved_state import Downtime, SavedSignal, SavedState
from .signal_monitor import SignalMonitor
from .sources import is_source
from .wording import Judgement, bounds_text, judged_unit, source_text

__all__ = [
    "Continuity", "Downtime", "Judgement", "MAX_EVIDENCE", "MOST_REFUSED", "Monitor", "NO_SAMPLES", "PERIOD_S",
    "STATE", "SampleCollector", "SampleSummary", "SavedMonitor", "SavedSignal", "SavedState", "SignalHistory",
    "SignalMonitor", "THRESHOLDS", "TICKS", "bounds_text", "config_of", "is_source", "judged_unit", "number_of",
    "own_config", "read_saved_monitor", "source_text", "thresholds_tree",
]  # fmt: skip
