"""The page of a report: complete, small, and safe against what recordings contain."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import random
import re
import time
from typing import Any, Iterator, Sequence

import pytest

from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.values.model import Forecast, Level, Status, Transition
from robot_health_monitor.ops.report.plotted_signal import MOST_LEVELS, PlottedSignal
from robot_health_monitor.ops.report.report import MOST_ALERTS, Report, ReportedAlert, buckets_of, render
from robot_health_monitor.ops.report.summaries import SummaryRow

START_S = 1_700_000_000.0
"""2023-11-14 22:13:20 UTC."""


def transition(level: Level = Level.WARN, text: str = "battery WARN: 19 % is below 20 %") -> Transition:
    """Returns a transition of the signal battery."""
    status = Status("battery", level, text, "robot", {})
    return Transition(
        "battery", Level.OK, level, 19.0, "last", 20.0, 5.0, 0.0, "robot", "0123456789abcdef", text, status
    )


def battery(**config: Any) -> PlottedSignal:
    """Returns a signal with ten samples, one per second."""
    bounds = {} if "warn_above" in config else {"warn_below": 20.0}
    plotted = PlottedSignal(read_signal("battery", {"unit": "%", **bounds, **config}), "", START_S, 9.0, 16)
    for second in range(10):
        plotted.add(START_S + second, 30.0 - 2.0 * second)
    return plotted


def report(signals: Sequence[PlottedSignal] = (), alerts: Sequence[ReportedAlert] = (), **others: Any) -> Report:
    """Returns a report of 9 s."""
    rows = [row(signal.config.name, signal.file) for signal in signals] or [row("battery")]
    plots = {(signal.file, signal.config.name): signal for signal in signals}
    made = Report(
        "Replay of test.bag", "1 alert", [], START_S, START_S + 9.0, ["samples"], rows, plots, alerts,
        len(alerts),
    )  # fmt: skip
    return made._replace(**others)


def row(name: str, file: str = "", cause: str = "", **figures: str) -> SummaryRow:
    """Returns the row of a signal that was always OK."""
    return SummaryRow(name, file, cause, {Level.OK: 1.0}, 0.0, 0, {"samples": "10", **figures})


@pytest.fixture(autouse=True)
def an_hour_ahead(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Sets the local time zone to one hour ahead of UTC."""
    monkeypatch.setenv("TZ", "UTC-1")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def data_of(page: str) -> dict[str, Any]:
    """Returns the data in a page."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(found[1])
    return data


def test_a_signal_has_its_samples_bounds_and_levels() -> None:
    plotted = battery(hysteresis=2.0, error_below=10.0)
    plotted.add_level(START_S + 6.0, transition().to_level.name)
    (signal,) = data_of(render(report([plotted])))["signals"]
    assert (signal["name"], signal["unit"], signal["start"]) == ("battery", "%", START_S)
    assert signal["low"] == signal["high"] == [30.0, 28.0, 26.0, 24.0, 22.0, 20.0, 18.0, 16.0, 14.0, 12.0]
    # Ten samples in sixteen buckets: numbers 0, 1, 3, 5, 7, 8, 10, 12, 14, 15.
    assert signal["steps"] == [1, 1, 2, 2, 2, 1, 2, 2, 2, 1]
    assert signal["bounds"] == [
        {"level": "WARN", "side": "below", "value": 20.0, "clears": 22.0},
        {"level": "ERROR", "side": "below", "value": 10.0, "clears": 12.0},
    ]
    assert signal["levels"] == [[START_S, "OK"], [START_S + 6.0, "WARN"]]


def test_a_signal_is_ok_from_its_first_sample() -> None:
    plotted = PlottedSignal(read_signal("battery", {"statistic": "mean"}), "", START_S, 9.0, 16)
    plotted.add_bad(START_S)
    for second in range(10):
        plotted.add(START_S + second, float(second))
    plotted.add_level(START_S + 3.0, transition().to_level.name)
    assert plotted.levels == [(START_S, "OK"), (START_S + 3.0, "WARN")]


def test_the_level_of_a_time_that_is_not_recorded_is_unknown() -> None:
    plotted = PlottedSignal(read_signal("battery", {}), "", START_S, 99.0, 16)
    plotted.add_gap(START_S - 20.0, START_S - 10.0)
    plotted.add(START_S, 1.0)
    plotted.add_gap(START_S + 10.0, START_S + 20.0)
    plotted.add_level(START_S + 25.0, transition().to_level.name)
    plotted.add_gap(START_S + 30.0, START_S + 40.0)
    levels = [(0.0, "OK"), (10.0, ""), (20.0, "OK"), (25.0, "WARN"), (30.0, ""), (40.0, "WARN")]
    assert plotted.levels == [(START_S + at_s, level) for at_s, level in levels]


def forecast(latest: float, value: float, meets_s: float | None, text: str = "") -> Status:
    """A forecast 60 s ahead."""
    line = Forecast(value, -0.5, 60.0, meets_s, None if meets_s is None else 20.0)
    return Status("battery", Level.WARN, "", "robot", {"last": f"{latest:g}"}, forecast=line, outlook=text)


def test_the_line_of_a_forecast_begins_at_the_value_and_extends_no_plot() -> None:
    """The value is 47; the least-squares line is at 45 now, at 15 in 60 s, and so at 20 in 50 s."""
    plotted = battery(statistic="forecast", window_s=40.0, forecast_s=60.0)
    first = dataclasses.replace(transition(), status=forecast(47.0, 15.0, 50.0, "reaches 20 % in 50 s"))
    later = dataclasses.replace(transition(), status=forecast(60.0, 30.0, 80.0))
    over = dataclasses.replace(transition(Level.OK), status=forecast(50.0, 40.0, None))
    undefined = transition(Level.ERROR)
    shown = ((2.0, first), (4.0, later), (5.0, over), (6.0, undefined))
    data = data_of(render(report([plotted], [ReportedAlert(START_S + at_s, "", each) for at_s, each in shown])))
    (signal,) = data["signals"]
    assert signal["ahead"] == [
        {
            "id": "alert-0",
            "from": [START_S + 2.0, 47.0],
            "to": [START_S + 62.0, 15.0],
            "meets": [START_S + 52.0, 20.0],
            "text": "reaches 20 % in 50 s",
        },
        {"id": "alert-1", "from": [START_S + 4.0, 60.0], "to": [START_S + 64.0, 30.0], "meets": None, "text": ""},
    ]
    assert (data["to"], signal["until"]) == (START_S + 9.0, START_S + 9.0)
    assert signal["name"] == "battery, with its forecast for the next 60 s"


def test_an_upper_bound_clears_below_it() -> None:
    (signal,) = data_of(render(report([battery(warn_above=80.0, hysteresis=5.0)])))["signals"]
    assert signal["bounds"] == [{"level": "WARN", "side": "above", "value": 80.0, "clears": 75.0}]


@pytest.mark.parametrize(
    ("statistic", "unit"), [("last", "%"), ("mean", "%"), ("rate", "%/s"), ("frequency_hz", "Hz"), ("stddev", "%")]
)
def test_the_unit_is_that_of_the_statistic(statistic: str, unit: str) -> None:
    (signal,) = data_of(render(report([battery(statistic=statistic)])))["signals"]
    assert signal["unit"] == unit


def test_alerts_and_plots_refer_to_each_other() -> None:
    page = render(report([battery()], [ReportedAlert(START_S + 6.0, "", transition())]))
    (signal,) = data_of(page)["signals"]
    (alert,) = signal["alerts"]
    assert (alert["t"], alert["level"], alert["id"]) == (START_S + 6.0, "WARN", "alert-0")
    assert f'<tr id="{alert["id"]}">' in page
    assert f'<section class="signal" id="{signal["id"]}">' in page
    assert f'<a href="#{signal["id"]}" data-alert="alert-0"' in page


def test_times_are_local_to_the_machine_that_replayed() -> None:
    page = render(report([battery()], [ReportedAlert(START_S + 6.0, "", transition())]))
    assert "2023-11-14 23:13:26" in page  # one hour ahead of UTC


def test_a_signal_that_is_not_plotted_has_a_row_without_a_link() -> None:
    page = render(report([battery()], rows=[row("battery"), row("gps", samples="not recorded")]))
    assert '<a href="#signal-0">battery</a>' in page
    assert '<td class="name">gps</td><td class="number" data-head="samples">not recorded</td>' in page


def test_two_configurations_have_a_plot_each() -> None:
    plots = [battery(), battery(warn_below=40.0)]
    for plot, file in zip(plots, ("a.yaml", "b.yaml")):
        plot.file = file
    page = render(
        report(
            plots,
            [ReportedAlert(START_S, "b.yaml", transition())],
        )
    )
    first, second = data_of(page)["signals"]
    assert (first["name"], second["name"]) == ("battery (a.yaml)", "battery (b.yaml)")
    assert [len(first["alerts"]), len(second["alerts"])] == [0, 1]
    assert '<a href="#signal-1" data-alert="alert-0"' in page
    # Long paths are broken, so that the numbers beside them fit on paper.
    assert [len(re.findall(f'<td class="file"[^>]*>{name}</td>', page)) for name in ("a.yaml", "b.yaml")] == [1, 2]


HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(1)>\"'&\u202e\x1b[2J<!--"


def test_texts_from_outside_are_escaped_everywhere() -> None:
    plotted = battery(unit="</script>")
    plotted.file = HOSTILE
    page = render(
        report(
            [plotted],
            [ReportedAlert(START_S, HOSTILE, transition(text=HOSTILE))],
            title=HOSTILE,
            judged_by=HOSTILE,
            verdict=HOSTILE,
            problems=[HOSTILE],
            rows=[row("battery", HOSTILE, samples=HOSTILE), row(HOSTILE, "other")],
        )
    )
    assert "<script>alert" not in page
    assert "<img" not in page
    assert "<!--" not in page
    assert "\x1b" not in page
    assert "\u202e" not in page
    assert page.count("</script>") == 3  # the data and two scripts
    assert data_of(page)["signals"][0]["alerts"][0]["text"].startswith("</script><script>")


def test_only_the_scripts_and_the_style_of_the_page_are_allowed() -> None:
    page = render(report([battery()]))
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    assert policy is not None
    assert policy[1].startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe" not in policy[1]
    sources = re.findall(r"<(?:script|style)>(.*?)</(?:script|style)>", page, re.DOTALL)
    assert len(sources) == 3
    for source in sources:
        digest = base64.b64encode(hashlib.sha256(source.encode("utf-8")).digest()).decode("ascii")
        assert f"'sha256-{digest}'" in policy[1]


def test_the_page_refers_to_nothing_outside() -> None:
    page = render(report([battery()]))
    assert re.findall(r"(?:src|href)=\"(?!#)[^\"]*\"", page) == []
    assert {*re.findall(r"https?://[^\"' ]*", page)} <= {"http://www.w3.org/2000/svg"}
    assert "innerHTML" not in page


@pytest.mark.newest_python
def test_a_day_of_ten_signals_is_smaller_than_2_mb() -> None:
    noise = random.Random(1)
    plots = []
    for number in range(10):
        config = read_signal(f"signal_{number}", {"warn_above": 80.0})
        plot = PlottedSignal(config, "", START_S, 86_400.0, buckets_of(10))
        for second in range(86_400):
            plot.add(START_S + second, 123.4567 if second == 40_000 else noise.gauss(50.0, 5.0))
        plots.append(plot)
    alerts = [ReportedAlert(START_S + place, "", transition()) for place in range(MOST_ALERTS)]
    page = render(report(plots, alerts))
    assert len(page.encode("utf-8")) < 2_000_000
    assert [max(signal["high"]) for signal in data_of(page)["signals"]] == [123.4567] * 10


def test_many_signals_share_the_points() -> None:
    assert (buckets_of(1), buckets_of(10), buckets_of(100), buckets_of(1000)) == (4096, 4096, 500, 256)


def test_the_number_of_levels_is_bounded_and_the_rest_unknown() -> None:
    plotted = battery()
    for place in range(MOST_LEVELS + 10):
        plotted.add_level(START_S + place, transition(Level.OK if place % 2 else Level.WARN).to_level.name)
    assert len(plotted.levels) == MOST_LEVELS + 1
    assert plotted.levels[-1] == (START_S + MOST_LEVELS - 1, "")  # the first is the OK of the first sample


def test_alerts_beyond_the_table_are_counted() -> None:
    page = render(report([battery()], [ReportedAlert(START_S, "", transition())], all_alerts=5000))
    assert "The first 1 of 5000." in page


def test_a_page_without_alerts_and_signals() -> None:
    page = render(report(problems=["test.bag: ends early"]))
    assert "<li>test.bag: ends early</li>" in page
    assert data_of(page)["signals"] == []


@pytest.mark.parametrize(
    ("head", "text", "expected"),
    [
        ("OK", "75.5 %", "number share ok"),
        ("WARN", "19.9 %", "number share warn"),
        ("ERROR", "0.1 %", "number share error"),
        ("STALE", "100 %", "number share stale"),
        ("unknown", "3 %", "number share unknown"),
        ("ERROR", "0 %", "number zero"),
        ("max", "0 %", "number"),
    ],
)
def test_a_share_that_is_not_zero_has_a_colour(head: str, text: str, expected: str) -> None:
    page = render(report(columns=[head], rows=[row("battery", **{head: text})]))
    assert f'<td class="{expected}" data-head="{head}">{text}</td>' in page


def test_degrees_have_their_sign_in_cells_rules_plots_and_alerts() -> None:
    line = "battery WARN: 85 degC is above 80 degC"
    signal = battery(unit="degC")
    alerts = [ReportedAlert(START_S, "", transition(text=line))]
    page = render(report([signal], alerts, columns=["max"], rows=[row("battery", max="85 degC")]))
    assert '<td class="number" data-head="max">85 °C</td>' in page
    assert "<p>WARN below 20 °C</p>" in page
    assert data_of(page)["signals"][0]["unit"] == "°C"
    assert "battery WARN: 85 °C is above 80 °C" in page
    assert "degC" not in page


def test_bounds_are_words() -> None:
    assert "<p>WARN below 20 %, ERROR below 10 %</p>" in render(report([battery(error_below=10.0)]))


def test_effects_are_listed_with_their_alert_and_marked_in_the_table() -> None:
    alert = ReportedAlert(START_S, "", transition(), effects=["left", "<b>"])
    rows = [row("left", cause="/scan"), row("/scan"), row("gps"), row("right", cause="/scan")]
    page = render(report([], [alert], rows=rows))
    assert "<details><summary>2 affected</summary>left, &lt;b&gt;</details>" in page
    kinds = re.findall(r'<tr([^>]*)><td class="name">(?:<[^>]*>)?([^<]*)', page)
    assert kinds == [
        (' data-effects="2"', "/scan"), (' class="effect"', "left"), (' class="effect"', "right"), ("", "gps"),
    ]  # fmt: skip
