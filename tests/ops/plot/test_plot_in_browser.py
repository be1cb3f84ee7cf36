"""The plot and the report in a real browser; skipped where none is installed."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from harness.browser import show

from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.values.model import Level, Status, Transition
from robot_health_monitor.ops.plot import plot_script, plot_style
from robot_health_monitor.ops.report.plotted_signal import PlottedSignal
from robot_health_monitor.ops.report.report import Report, ReportedAlert, render
from robot_health_monitor.ops.report.summaries import SummaryRow

pytestmark = pytest.mark.newest_python

START_S = 1_700_000_000.0
"""2023-11-14 22:13:20 UTC."""

SIGNAL = {
    "name": "battery", "unit": "%", "start": 0.0, "width": 1.0, "gap": 5.0,
    "steps": [1] * 100,
    "low": [50.0] * 49 + [-7.0] + [50.0] * 50,
    "high": [50.0] * 60 + [99.5] + [50.0] * 39,
    "bad": [10.0],
    "bounds": [{"level": "WARN", "side": "below", "value": 20.0, "clears": 22.0}],
    "levels": [[0.5, "OK"], [49.5, "WARN"], [52.5, "OK"]],
    "alerts": [{"id": "alert-0", "t": 49.5, "level": "WARN", "text": "<b>low</b>"}],
}  # fmt: skip

SCRIPT = """
const view = new HealthPlot.View(0, 100, 3600);
const box = document.getElementById("box");
const plot = new HealthPlot.Plot(box, signal, view);
const svg = box.querySelector("svg");
const count = (selector) => svg.querySelectorAll(selector).length;
const path = () => svg.querySelector(".value").getAttribute("d");
const ys = () => path().match(/[ML][-\\d.]+ [-\\d.]+/g).map((p) => +p.split(" ")[1]);
const key = (name) => svg.dispatchEvent(new KeyboardEvent("keydown", {key: name, cancelable: true}));
const point = (type, t, more) => svg.dispatchEvent(new PointerEvent(type, {
  clientX: svg.getBoundingClientRect().left + plot.x(t), clientY: svg.getBoundingClientRect().top + 50,
  pointerId: 1, pointerType: "mouse", bubbles: true, ...more}));
svg.setPointerCapture = () => {};
const result = {};
result.bands = count(".band.warn");
result.bounds = count("line.bound.warn");
const strips = [...svg.querySelectorAll(".strip")];
result.strips = strips.map((strip) => strip.getAttribute("class") + " " + strip.getAttribute("height"));
result.markers = count("a .marker");
result.title = svg.querySelector("a title").textContent;
result.href = svg.querySelector("a").getAttribute("href");
result.bad = count(".bad");
result.lowest = Math.abs(Math.max(...ys()) - plot.y(-7)) < 0.1;
result.highest = Math.abs(Math.min(...ys()) - plot.y(99.5)) < 0.1;
result.label = svg.getAttribute("aria-label");
point("pointermove", 60.5);
result.readOut = box.querySelector("output").textContent;
point("pointermove", 20.5);
result.readOutOfOne = box.querySelector("output").textContent;
key("+");
result.zoomed = [view.from, view.to];
key("ArrowRight");
result.moved = [view.from, view.to];
key("0");
result.all = [view.from, view.to];
key("-");
result.notBeyond = [view.from, view.to];
plot.draw();
point("pointerdown", 20, {button: 0});
point("pointermove", 40);
result.selection = count(".selection");
point("pointerup", 40);
result.dragged = [Math.round(view.from), Math.round(view.to)];
plot.draw();
result.rangeAfterDrag = [plot.dataLow, plot.dataHigh];
box.querySelectorAll("button")[2].click();
result.button = [view.from, view.to];
plot.draw();
const touch = (type, id, t) => point(type, t, {pointerType: "touch", pointerId: id});
touch("pointerdown", 1, 40); touch("pointerdown", 2, 60); touch("pointermove", 2, 80);
result.pinched = Math.round(view.to - view.from);
touch("pointerup", 1, 40); touch("pointerup", 2, 80);
view.showAll();
svg.dispatchEvent(new WheelEvent("wheel", {deltaY: -1, clientX: 100}));
result.wheelWithoutFocus = [view.from, view.to];
svg.dispatchEvent(new WheelEvent("wheel", {deltaY: -1, ctrlKey: true, cancelable: true,
  clientX: svg.getBoundingClientRect().left + plot.x(50)}));
result.wheel = Math.round(view.to - view.from);
view.showAll();
plot.pick("alert-0");
result.picked = count("a.picked");
result.gapBroken = (() => {
  plot.update({...signal, steps: [1, 1, 20, 1], low: [1, 2, 3, 4], high: [1, 2, 3, 4]});
  return (path().match(/M/g) || []).length;
})();
plot.update({...signal, steps: [], low: [], high: [], levels: [], alerts: [], bad: []});
result.empty = svg.getAttribute("aria-label");
const line = (id, t, value, slope, meets, text) => ({id, from: [t, value], to: [t + 40, value + 40 * slope],
  meets: meets && [t + meets, value + meets * slope], text});
const ahead = [line("alert-0", 60, 50, -1, 30, "reaches 20 %, first"), line("", 100, 50, -2, 15, "reaches 20 %")];
plot.pick("");
plot.update({...signal, low: Array(100).fill(50), high: Array(100).fill(50), until: 100, ahead});
result.withoutRoom = [count(".ahead"), count(".beyond")];  // the axis ends at 100 s
view.extend(0, 140);
view.showAll();
plot.draw();
result.ahead = [...svg.querySelectorAll(".ahead")].map((path) => path.getAttribute("class"));
const ring = svg.querySelector(".meets");
result.ring = [ring.getAttribute("class"), Math.abs(ring.getAttribute("cx") - plot.x(115)) < 0.1,
  Math.abs(ring.getAttribute("cy") - plot.y(20)) < 0.1];
result.aheadText = svg.querySelector(".ahead-text").textContent;
result.inside = (() => {
  const text = svg.querySelector(".ahead-text").getBBox();
  return text.x >= plot.left && text.x + text.width <= plot.right && text.y >= 0 && text.y + text.height <= plot.bottom;
})();
result.rangeAhead = [plot.lowest < -10, plot.highest > 50];  // to -30, but at most by the height of the rest
result.stripEnds = Math.abs(Math.max(...[...svg.querySelectorAll(".strip")].map(
  (strip) => +strip.getAttribute("x") + +strip.getAttribute("width"))) - plot.x(100)) < 0.2;
result.aheadLabel = svg.getAttribute("aria-label");
point("pointermove", 110);
result.readOutAhead = box.querySelector("output").textContent;
plot.pick("alert-0");
result.pickedAhead = [svg.querySelector(".ahead-text").textContent, svg.querySelector("a.picked") !== null];
plot.pick("");
plot.update({...signal, until: 100, ahead: [line("", 100, 50, -1000, null, "")]});
result.steep = [plot.lowest > -600, count(".meets"), count(".ahead-text")];
view.extend(0, 100);
result.time = [HealthPlot.timeText(1700000000, 3600, 60, true), HealthPlot.timeText(1700000000.25, 0, 0.1, false)];
const text = document.createElement("pre");
text.id = "result";
text.textContent = JSON.stringify(result);
document.body.append(text);
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Returns what a script saw of a plot."""
    page = tmp_path_factory.mktemp("plot") / "plot.html"
    page.write_text(
        f"<!DOCTYPE html><meta charset='utf-8'><style>{plot_style()}</style><div id='box'></div>"
        f"<script>{plot_script()}</script><script>const signal = {json.dumps(SIGNAL)};\n{SCRIPT}</script>",
        encoding="utf-8",
    )
    shown = show(page)
    result = re.search(r'<pre id="result">(.*?)</pre>', shown.dom)
    assert result is not None, shown.console
    seen: dict[str, Any] = json.loads(unescape(result[1]))
    return seen


def test_a_plot_shows_bounds_with_their_hysteresis(found: dict[str, Any]) -> None:
    assert (found["bounds"], found["bands"]) == (1, 1)


def test_levels_differ_in_more_than_colour(found: dict[str, Any]) -> None:
    kinds, heights = zip(*(strip.rsplit(" ", 1) for strip in found["strips"]))
    assert kinds == ("strip ok", "strip warn", "strip ok")
    assert heights[0] == heights[2] != heights[1]


def test_an_alert_is_a_link_with_its_text(found: dict[str, Any]) -> None:
    assert (found["markers"], found["href"], found["title"]) == (1, "#alert-0", "<b>low</b>")
    assert found["picked"] == 1


def test_extremes_and_bad_samples_are_drawn(found: dict[str, Any]) -> None:
    assert (found["lowest"], found["highest"], found["bad"]) == (True, True, 1)


def test_the_read_out_has_time_value_and_level(found: dict[str, Any]) -> None:
    assert found["readOut"] == "1970-01-01 01:01:00 · 50 to 99.5 % · OK"
    assert found["readOutOfOne"] == "1970-01-01 01:00:20 · 50 % · OK"


def test_keys_zoom_and_move(found: dict[str, Any]) -> None:
    assert found["zoomed"] == [25.0, 75.0]
    assert found["moved"] == [35.0, 85.0]
    assert found["all"] == found["notBeyond"] == [0.0, 100.0]


def test_dragging_zooms_and_the_range_follows(found: dict[str, Any]) -> None:
    assert (found["selection"], found["dragged"]) == (1, [20, 40])
    assert found["rangeAfterDrag"] == [50.0, 50.0]
    assert found["button"] == [0.0, 100.0]


def test_pinching_zooms(found: dict[str, Any]) -> None:
    assert found["pinched"] == 50  # the fingers are twice as far apart


def test_the_wheel_zooms_only_on_request(found: dict[str, Any]) -> None:
    assert found["wheelWithoutFocus"] == [0.0, 100.0]
    assert found["wheel"] == 80


def test_the_line_breaks_at_a_gap(found: dict[str, Any]) -> None:
    assert found["gapBroken"] == 2


def test_a_plot_can_be_empty(found: dict[str, Any]) -> None:
    assert found["empty"].startswith("battery: no samples. Keys")


def test_times_are_local(found: dict[str, Any]) -> None:
    assert found["time"] == ["2023-11-14 23:13", "22:13:20.250"]


def test_its_description_is_for_screen_readers(found: dict[str, Any]) -> None:
    assert found["label"].startswith("battery: -7 % to 99.5 %, 1 alert.")


def test_the_lines_of_forecasts_are_dotted_ahead_and_the_latest_stands_out(found: dict[str, Any]) -> None:
    assert found["ahead"] == ["ahead", "ahead chosen"]
    assert found["aheadText"] == "reaches 20 %"
    assert found["aheadLabel"].startswith("battery: 50 % to 50 %, 1 alert, reaches 20 %.")
    assert found["withoutRoom"] == [2, 0]


def test_a_mark_is_where_the_line_meets_its_bound(found: dict[str, Any]) -> None:
    assert found["ring"] == ["meets warn", True, True]
    assert found["inside"]
    assert found["rangeAhead"] == [True, True]


def test_levels_end_where_the_future_begins_and_the_read_out_goes_on(found: dict[str, Any]) -> None:
    assert found["stripEnds"]
    assert found["readOutAhead"] == "1970-01-01 01:01:50 \u00b7 forecast 30 %"


def test_the_line_of_the_picked_alert_stands_out(found: dict[str, Any]) -> None:
    assert found["pickedAhead"] == ["reaches 20 %, first", True]


def test_a_steep_line_leaves_room_for_the_values(found: dict[str, Any]) -> None:
    assert found["steep"] == [True, 0, 0]


@pytest.mark.parametrize("width", [1280, 500])
def test_the_report_draws_its_plots_under_its_own_policy(tmp_path: Path, width: int) -> None:
    config = read_signal("battery", {"unit": "%", "warn_below": 20.0, "hysteresis": 2.0})
    plotted = PlottedSignal(config, "", START_S, 99.0, 64)
    for second in range(100):
        plotted.add(START_S + second, 60.0 - 50.0 * second / 99.0)
    status = Status("battery", Level.WARN, "", "robot", {})
    transition = Transition(
        "battery", Level.OK, Level.WARN, 19.9, "last", 20.0, 80.0, 0.0, "robot", "0" * 16, "battery WARN", status
    )
    plotted.add_level(START_S + 80.0, transition.to_level.name)
    page = tmp_path / "report.html"
    alerts = [ReportedAlert(START_S + 80.0, "", transition)]
    report = Report(
        "Replay", "1 alert", [], START_S, START_S + 99.0, ["alerts"],
        [SummaryRow("battery", "", "", {}, 0.0, 1, {})], {("", "battery"): plotted}, alerts, 1,
    )  # fmt: skip
    page.write_text(render(report), encoding="utf-8")
    shown = show(page, width)
    assert shown.console == ""
    assert shown.dom.count("<svg") == 1
    assert 'class="strip warn"' in shown.dom
    assert '<a href="#alert-0">' in shown.dom
