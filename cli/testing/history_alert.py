"""A past alert as a history has it, for its unit test: the samples in its window."""

from __future__ import annotations

import math
import sqlite3

from ...core.config.kept_settings import read_kept
from ...core.config.signal_config import LINK, OF_ARRIVALS, SignalConfig, template_name
from ...core.judge.continuity import MAX_EVIDENCE
from ...core.values.errors import ConfigError
from ...core.values.formatting import duration_text, list_text, printable
from ...core.values.model import Level
from ...ops.store import queries
from ...ops.store.rows import StoredTransition
from .past_alert import FROM_ALERT, PastAlert, Samples, depends_on, needed_before_s, needed_settings


def history_alert(connection: sqlite3.Connection, number: int) -> PastAlert:
    """Returns the alert with this id; raises ConfigError if there is none, or if no test can have its input."""
    transition = queries.transition(connection, number)
    if transition is None:
        raise ConfigError(f"there is no alert {number} in this history")
    if transition.repeat:
        raise ConfigError(f"{FROM_ALERT}: {number} repeats an earlier alert; expected the id of that one")
    robot = printable(transition.robot)
    kept = queries.configuration(connection, transition.robot, transition.wall_s)
    if kept is None:
        raise ConfigError(f"{FROM_ALERT}: this history has no configuration of {robot}")
    try:
        signals = read_kept(kept)
    except ConfigError as error:
        raise ConfigError(f"{FROM_ALERT}: the configuration of {robot} cannot be read: {error}") from None
    settings = needed_settings(signals, transition.signal, robot)
    signal = signals[template_name(transition.signal)]
    stored = [each for each in queries.evidence(connection, transition.id) if math.isfinite(each[0])]
    is_of_arrivals = signal.statistic in OF_ARRIVALS
    samples: Samples = [] if is_of_arrivals else stored  # else those are values of the statistic
    if not is_of_arrivals and _is_invalid(transition, signal):
        number_ = float(transition.value) if isinstance(transition.value, (int, float)) else math.nan
        samples = [*samples, (transition.wall_s, number_)]
    recorder = f"a black box (ops.yaml: black_box, before_s: {needed_before_s(signal)}) would have recorded it"
    if transition.black_box:
        recorder = f"its black box {transition.black_box} has it: name its folder by --ops, or the file itself"
    return PastAlert(
        title=f"alert {transition.id} of {transition.robot}",
        line=transition.text,
        wall_s=transition.wall_s,
        settings=settings,
        signal=transition.signal,
        from_level=transition.from_level,
        to_level=transition.to_level,
        time_s=transition.wall_s,
        samples={transition.signal: samples},
        missing=f"{_missing(transition, signal, samples)}; {recorder}",
        black_box=transition.black_box,
    )


def _is_invalid(transition: StoredTransition, signal: SignalConfig) -> bool:
    """Returns whether bad data gave the alert."""
    is_judged = signal.is_status or transition.signal == LINK or transition.bound is not None
    return transition.to_level is Level.ERROR and not is_judged


def _missing(transition: StoredTransition, signal: SignalConfig, samples: Samples) -> str:
    others = depends_on(signal)
    if signal.statistic in OF_ARRIVALS:
        return "a history has no times of arrivals"
    if not samples:
        return "no samples are stored with it"
    if others:
        return f"the samples of {list_text(others)}, which it depends on, are not stored with it"
    if len(samples) >= MAX_EVIDENCE:
        return f"only {MAX_EVIDENCE} of the samples in its window are stored"
    if _is_invalid(transition, signal):
        return "bad samples before it are not stored"
    return f"what came more than {duration_text(transition.wall_s - samples[0][0])} before it is not stored"
