"""Remarks about questionable configurations."""

from __future__ import annotations

from typing import Any

import pytest

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.config.remarks import doubt_of, remarks_of
from robot_health_monitor.core.config.signal_config import read_signal

DOUBT = "a forecast of a voltage is questionable; prefer the charge in %"
SHORT = "with forecast_s (1800) above window_s (600), noise alerts falsely; set it to at least 300"


def remarks_about(**settings: Any) -> list[tuple[str, str]]:
    return list(remarks_of(read_signal("cell", settings)))


def forecast(**settings: Any) -> dict[str, Any]:
    return {"statistic": "forecast", "forecast_s": 600.0, "warn_below": 3.4, **settings}


def test_lifecycle_is_an_error_on_ros_1() -> None:
    remark = "on ROS 1, which has no lifecycle nodes, this is an error"
    assert remarks_about(lifecycle="/nav") == [("lifecycle", remark)]
    assert remarks_about(node="/nav") == []


@pytest.mark.parametrize("unit", ["V", "mV"])
def test_a_forecast_of_a_voltage_is_questionable(unit: str) -> None:
    assert remarks_about(**forecast(unit=unit)) == [("unit", DOUBT)]


def test_other_forecasts_and_other_statistics_of_a_voltage_are_not() -> None:
    assert remarks_about(**forecast(unit="%")) == remarks_about(**forecast()) == []
    assert remarks_about(unit="V", warn_below=3.4) == remarks_about(unit="V", statistic="mean", warn_below=3.4) == []


@pytest.mark.parametrize(
    ("settings", "keys"),
    [
        ({}, ["for_s"]),
        ({"for_s": 299.0}, ["for_s"]),
        ({"for_s": 300.0}, []),
        ({"forecast_s": 600.0}, []),
        ({"error_below": 1.0}, ["for_s", "error_for_s"]),
        ({"error_below": 1.0, "for_s": 300.0}, []),
        ({"error_below": 1.0, "for_s": 300.0, "error_for_s": 60.0}, ["error_for_s"]),
        ({"warn_below": None, "error_below": 1.0, "error_for_s": 300.0}, []),
        ({"warn_below": None}, []),
    ],
)
def test_a_forecast_beyond_its_window_needs_for_s_of_half_a_window(settings: dict[str, Any], keys: list[str]) -> None:
    given = forecast(**{"forecast_s": 1800.0, **settings})
    found = remarks_about(**{key: value for key, value in given.items() if value is not None})
    assert found == [(key, SHORT) for key in keys]


def test_the_status_has_the_doubt_as_its_hint_but_no_alert_has() -> None:
    settings = forecast(unit="V", window_s=20.0, forecast_s=20.0)
    monitor = Monitor(load_config({"signals": {"cell": settings}}))
    changes = [
        change for second in range(30) for change in monitor.observe(Sample("cell", 3.5 - 0.01 * second, second))
    ]
    (alert,) = changes
    assert (alert.to_level, alert.hint) == (Level.WARN, "")
    status = monitor.report(30.0).statuses["cell"]
    assert (status.hint, DOUBT in status.message) == (DOUBT, False)


def test_a_reason_for_missing_samples_is_the_hint_instead() -> None:
    monitor = Monitor(load_config({"signals": {"cell": forecast(unit="V", window_s=600.0)}}))
    monitor.tick(0.0)
    monitor.note_hint("cell", "no publisher on /cell")
    assert monitor.report(1.0).statuses["cell"].hint == "no publisher on /cell"


def test_a_configuration_without_doubt_has_no_hint() -> None:
    assert doubt_of(read_signal("cell", {"unit": "V", "warn_below": 3.4})) == ""
