"""Forecasts of signals that will cross no bound: no alert. `make bench ARGS=forecast` counts them over 9,000 hours."""

from __future__ import annotations

import random

import pytest
from harness import forecast_scenes
from harness.forecast_scenes import FORECAST_S, NOISES, SCENES

pytestmark = pytest.mark.newest_python


@pytest.mark.parametrize("noise", NOISES, ids=lambda noise: "{:g} % over {:g} s".format(*noise))
def test_noise_is_no_trend(noise: tuple[float, float]) -> None:
    assert forecast_scenes.false_alarms(forecast_scenes.flat(*noise), 2 * 3600, warn_below=40.0) == 0


@pytest.mark.parametrize("what", SCENES)
def test_what_will_not_reach_its_bound_gives_no_alert(what: str) -> None:
    assert SCENES[what].false_alarms(random.Random(f"{what} 0")) == 0


def test_one_line_through_the_window_alerts_falsely_where_the_forecast_does_not() -> None:
    assert forecast_scenes.false_alarms_of_one_line(forecast_scenes.flat(3.0, 60.0), 20 * 3600) > 0
    assert forecast_scenes.false_alarms(forecast_scenes.flat(3.0, 60.0), 20 * 3600, warn_below=40.0) == 0


def test_a_discharge_is_noticed_early() -> None:
    leads_s = sorted(forecast_scenes.lead_s(random.Random(number)) for number in range(5))
    assert 0.8 * FORECAST_S <= leads_s[2] <= FORECAST_S


def test_a_bound_that_will_be_crossed_is_an_alert_in_each_scene() -> None:
    """The same values with a bound that lies on their way: the scenes are able to alert."""
    for what, scene in SCENES.items():
        crossed = {"warn_above": 50.0} if "warn_above" in scene.settings else {"warn_below": 101.0}
        settings = {name: value for name, value in scene.settings.items() if not name.startswith("warn")}
        assert scene._replace(settings={**settings, **crossed}).false_alarms(random.Random(what)) > 0, what
