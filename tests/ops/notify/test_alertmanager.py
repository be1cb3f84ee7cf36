"""Alerts at a real Alertmanager, and the requests as they are sent."""

from __future__ import annotations

import datetime
import json
import time
from typing import Any

import pytest
from harness.alertmanager import RunningAlertmanager, needs_alertmanager
from harness.http_server import HttpServer, responding
from harness.transitions import transition

from robot_health_monitor.core import Level
from robot_health_monitor.core.nodes.outlets import json_line
from robot_health_monitor.ops.configuration import TargetSettings
from robot_health_monitor.ops.notify.alertmanager import Alertmanager
from robot_health_monitor.ops.notify.sender import DeliveryError, Notification

BEGIN_S = 1_700_000_000.0


def notification(level: str, at_s: float, **fields: Any) -> Notification:
    event = transition(to_level=Level[level], robot="r3", signal=fields.pop("signal", "battery"), text=f"line {level}")
    return Notification(json.loads(json_line(event)), level == "OK", at_s, **fields)


WARN = notification("WARN", BEGIN_S)


def target(url: str, wall_time_s: Any = time.time) -> Alertmanager:
    return Alertmanager(TargetSettings("pager", "alertmanager", url=url), wall_time_s)


def labels(level: str, severity: str) -> dict[str, str]:
    return {"alertname": "RobotHealth", "robot": "r3", "signal": "battery", "level": level, "severity": severity}


@pytest.mark.parametrize(("level", "severity"), [("WARN", "warning"), ("ERROR", "critical"), ("STALE", "warning")])
def test_an_alert_carries_labels_summary_and_begin(server: HttpServer, level: str, severity: str) -> None:
    assert target(f"{server.url}/prefix/").send(notification(level, BEGIN_S)) == "200 OK"
    received = server.next()
    assert received.path == "/prefix/api/v2/alerts"
    assert received.json == [
        {
            "labels": labels(level, severity),
            "annotations": {"summary": f"r3: line {level}"},
            "startsAt": "2023-11-14T22:13:20.000Z",
        }
    ]


def test_the_page_of_an_alert_and_what_to_do_come_with_it(server: HttpServer) -> None:
    plain = notification("WARN", BEGIN_S)
    for advice, name in (("check the cable", "what_to_do"), ("https://wiki/cable", "runbook_url")):
        fields = {**plain.transition, "link": "https://a/#alerts/7", "what_to_do": advice}
        target(server.url).send(Notification(fields, False, BEGIN_S))
        (alert,) = server.next().json
        assert alert["generatorURL"] == "https://a/#alerts/7"
        assert alert["annotations"] == {"summary": "r3: line WARN", name: advice}


def test_a_change_of_level_ends_the_old_alert_in_the_same_request(server: HttpServer) -> None:
    target(server.url).send(notification("ERROR", BEGIN_S + 60.0, before=WARN))
    assert server.next().json == [
        {
            "labels": labels("WARN", "warning"),
            "annotations": {"summary": "r3: line ERROR"},
            "startsAt": "2023-11-14T22:13:20.000Z",
            "endsAt": "2023-11-14T22:14:20.000Z",
        },
        {
            "labels": labels("ERROR", "critical"),
            "annotations": {"summary": "r3: line ERROR"},
            "startsAt": "2023-11-14T22:14:20.000Z",
        },
    ]


def test_no_alert_ends_before_its_begin(server: HttpServer) -> None:
    target(server.url).send(notification("OK", BEGIN_S - 3600.0, before=WARN))  # the clock was set back
    (alert,) = server.next().json
    assert alert["endsAt"] == alert["startsAt"]


def test_a_test_is_labelled(server: HttpServer) -> None:
    target(server.url).send(notification("WARN", BEGIN_S, is_test=True))
    (alert,) = server.next().json
    assert alert["labels"]["test"] == "true"


def test_many_alerts_are_repeated_in_several_requests(server: HttpServer) -> None:
    target(server.url).repeat([WARN] * 450)
    assert [len(request.json) for request in server.all()] == [200, 200, 50]


def test_a_refusal_shows_the_status(server: HttpServer) -> None:
    server.behave = responding(400, b"bad label")
    with pytest.raises(DeliveryError, match=r"^response 400 Bad Request$") as caught:
        target(server.url).send(notification("WARN", BEGIN_S))
    assert caught.value.is_refused


@needs_alertmanager
def test_an_alert_appears_changes_level_and_resolves(alertmanager: RunningAlertmanager) -> None:
    pager = target(alertmanager.url)
    begin_s = time.time() - 30.0
    first = notification("WARN", begin_s)
    pager.send(first)
    (alert,) = alertmanager.alerts()
    assert alert["labels"] == labels("WARN", "warning")
    assert alert["annotations"] == {"summary": "r3: line WARN"}
    assert alert["status"]["state"] in ("active", "unprocessed")
    begin = datetime.datetime.strptime(alert["startsAt"][:23] + "+0000", "%Y-%m-%dT%H:%M:%S.%f%z")
    assert begin.timestamp() == pytest.approx(begin_s, abs=0.001)
    second = notification("ERROR", begin_s + 10.0, before=first)
    pager.send(second)
    assert alertmanager.levels() == {"battery": "ERROR"}
    pager.repeat([second])
    assert alertmanager.levels() == {"battery": "ERROR"}
    pager.send(notification("OK", begin_s + 20.0, before=second))
    assert alertmanager.levels() == {}


@needs_alertmanager
@pytest.mark.parametrize("ahead_s", [7200.0, -7200.0, -1.7e9])
def test_a_wrong_clock_neither_loses_nor_prolongs_an_alert(alertmanager: RunningAlertmanager, ahead_s: float) -> None:
    def wrong_s() -> float:
        return time.time() + ahead_s

    signal = f"clock{ahead_s:g}"
    pager = target(alertmanager.url, wrong_s)
    first = notification("WARN", wrong_s(), signal=signal)
    # One in the future is refused by Alertmanager, whose response states its own time, and posted again.
    pager.send(first)
    assert alertmanager.levels() == {signal: "WARN"}
    pager.send(notification("OK", wrong_s(), signal=signal, before=first))
    assert alertmanager.levels() == {}
