"""What may have been before an alert: recorded silence stays silent, what is not stored is assumed, and said."""

from __future__ import annotations

from typing import Any, List, Sequence, Tuple

import pytest

from robot_health_monitor.alert_attempts import Attempt, RecordedAlert, attempts, conditions, window_begin_s
from robot_health_monitor.core import Level
from robot_health_monitor.core.signal_config import SignalConfig, read_signal


def signal_of(**settings: Any) -> SignalConfig:
    return read_signal("b", {"warn_below": 20.0, **settings})


def recorded_alert(
    samples: Sequence[Tuple[float, float]], wall_s: float = 1000.0, before: Sequence[RecordedAlert] = ()
) -> RecordedAlert:
    return RecordedAlert("b", Level.OK, Level.WARN, wall_s, 15.0, 20.0, samples, before)


def each_second(first_s: float, last_s: float, value: float) -> List[Tuple[float, float]]:
    return [(first_s + number, value) for number in range(round(last_s - first_s) + 1)]


def joined(signal: SignalConfig, recorded: RecordedAlert) -> List[Attempt]:
    """Returns the attempts that have earlier windows."""
    found = list(attempts(signal, recorded))
    return [each for each in found[1:] if "before the alert are recorded" not in each.remark]


def test_the_first_attempt_is_what_is_recorded() -> None:
    samples = each_second(990.0, 1000.0, 15.0)
    first = next(attempts(signal_of(window_s=10.0), recorded_alert(samples)))
    assert first == Attempt([(time_s - 1000.0, 15.0) for time_s, _ in samples])


def test_silence_within_a_window_stays_silent() -> None:
    """The signal was STALE from 980 to 986 s, which the window of the first alert covers."""
    samples = each_second(995.0, 1000.0, 15.0)
    earlier = each_second(975.0, 980.0, 50.0) + each_second(986.0, 994.0, 50.0)
    before = recorded_alert(earlier, 994.0)
    signal = signal_of(window_s=20.0, stale_after_s=5.0)
    (found, _) = joined(signal, recorded_alert(samples, before=[before]))
    assert found.remark == ""
    assert [time_s for time_s, _ in found.samples] == [time_s - 1000.0 for time_s, _ in [*earlier, *samples]]


def test_where_no_window_reaches_samples_are_assumed_and_said_to_be() -> None:
    """Windows of 5 s: nothing is stored of 980 to 995 s."""
    before = recorded_alert(each_second(975.0, 980.0, 40.0), 980.0)
    recorded = recorded_alert(each_second(995.0, 1000.0, 15.0), before=[before])
    held, valued = joined(signal_of(window_s=5.0, stale_after_s=5.0), recorded)
    assert held.remark == "where samples are not stored, the sample before is repeated (15 s in all)"
    assert [value for _, value in held.samples[6:20]] == [40.0] * 14
    assert [time_s for time_s, _ in held.samples[6:20]] == pytest.approx([*range(-19, -5)], abs=0.01)
    assert valued.remark == "where samples are not stored, the value of the alert before is repeated (15 s in all)"
    assert [value for _, value in valued.samples[6:20]] == [15.0] * 14
    assert [time_s for time_s, _ in valued.samples[6:20]] == pytest.approx([*range(-19, -5)], abs=0.01)


def test_the_window_of_a_statistic_ends_where_its_samples_do() -> None:
    recorded = recorded_alert(each_second(995.0, 1000.0, 15.0))
    assert window_begin_s(signal_of(window_s=5.0, statistic="mean"), recorded) == -5.0
    assert window_begin_s(signal_of(window_s=5.0), recorded) is None
    full = recorded_alert([(970.0 + number / 10.0, 15.0) for number in range(301)])
    assert window_begin_s(signal_of(window_s=60.0, statistic="mean"), full) is None


def test_a_release_that_ends_an_alert_comes_with_its_end() -> None:
    signal = signal_of(latch=True, latch_release_if={"signal": "charging", "is": 1.0})
    recorded = recorded_alert(each_second(995.0, 1000.0, 50.0))
    (not_released,) = conditions(signal, recorded, {})
    assert [value for _, value in not_released.samples["charging"]] == [2.0]
    (released,) = conditions(signal, recorded._replace(to_level=Level.OK), {})
    assert [value for _, value in released.samples["charging"]] == [2.0, 1.0]
    assert released.samples["charging"][-1][0] == 1000.0


def test_the_number_of_attempts_is_bounded() -> None:
    signal = signal_of(
        statistic="mean", window_s=600.0, error_below=10.0, warn_above=80.0, error_above=90.0, for_s=60.0,
        error_for_s=30.0, keep_firing_for_s=10.0,
    )  # fmt: skip
    before = [recorded_alert(each_second(100.0 * number, 100.0 * number + 5.0, 50.0), 100.0 * number + 5.0)
              for number in range(1, 6)]  # fmt: skip
    found = list(attempts(signal, recorded_alert(each_second(995.0, 1000.0, 15.0), before=before)))
    assert 10 < len(found) < 1000
    assert max(len(each.samples) for each in found) < 10_000
