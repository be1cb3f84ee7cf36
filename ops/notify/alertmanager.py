"""Target `alertmanager`: posts alerts to the API of Prometheus's Alertmanager, version 2.

An alert there is identified by its labels, the level among them. So a change of level ends one alert and begins
another, in one request. An open alert carries no end: Alertmanager ends it by its own clock, `resolve_timeout` (by
default 5 min) after the last repetition, so that a robot's wrong clock cannot end it.
https://github.com/prometheus/alertmanager/blob/main/api/v2/openapi.yaml
"""

from __future__ import annotations

import json
from functools import partial
from typing import Any, Callable, Sequence

from ...core.values import Level
from ...runtime.times import utc_text
from .sender import Notification
from .webhook import Webhook

# The labels `alertname` and `severity`; the exported rules have the same.
ALERT = "RobotHealth"
SEVERITIES = {Level.WARN: "warning", Level.ERROR: "critical", Level.STALE: "warning"}

REPEAT_EVERY_S = 30.0  # far below Alertmanager's default `resolve_timeout` of 5 min
_PATH = "/api/v2/alerts"
_BATCH = 200  # alerts per request
_TOLERATED_S = 30.0


class Alertmanager(Webhook):
    """Posts alerts, and repeats those that are open."""

    repeat_every_s = REPEAT_EVERY_S

    _ahead_s = 0.0
    """By how much this clock is ahead of the server's, in s; 0 if it is about right."""

    def send(self, notification: Notification) -> str:
        """Posts the end of the alert that is open there, if it changes, and the new one."""
        return self._post(partial(self._alerts, notification))

    def repeat(self, alerts: Sequence[Notification]) -> None:
        """Posts open alerts again."""
        for first in range(0, len(alerts), _BATCH):
            part = alerts[first : first + _BATCH]
            self._post(lambda part=part: [self._alert(alert, alert.text) for alert in part])  # type: ignore[misc]

    def _alerts(self, notification: Notification) -> list[dict[str, Any]]:
        alerts: list[dict[str, Any]] = []
        before, text = notification.before, notification.text
        if before is not None and (notification.is_resolved or before.level is not notification.level):
            alerts.append(self._alert(before, text, max(notification.at_s, before.at_s)))
        if not notification.is_resolved:
            alerts.append(self._alert(notification, text))
        if notification.is_test:
            for alert in alerts:
                alert["labels"]["test"] = "true"
        return alerts

    def _alert(self, alert: Notification, text: str, ended_s: float | None = None) -> dict[str, Any]:
        labels = {
            "alertname": ALERT, "robot": alert.robot, "signal": alert.signal,
            "level": alert.level.name, "severity": SEVERITIES[alert.level],
        }  # fmt: skip
        times = {"startsAt": utc_text(alert.at_s - self._ahead_s)}
        if ended_s is not None:
            times["endsAt"] = utc_text(ended_s - self._ahead_s)
        annotations = {"summary": text, **alert.annotations}
        link = annotations.pop("link", "")
        return {"labels": labels, "annotations": annotations, **times, **({"generatorURL": link} if link else {})}

    def _post(self, make: Callable[[], Sequence[dict[str, Any]]]) -> str:
        """Posts alerts, and again if the server refuses them because of this clock, which is then corrected."""
        answer = self.call(json.dumps(make()), _PATH)
        if answer.date_s is not None:
            # Alertmanager refuses an alert that begins far in the future, and would end one only in the future.
            ahead_s, known_s = self._wall_time_s() - answer.date_s, self._ahead_s
            self._ahead_s = ahead_s if abs(ahead_s) > _TOLERATED_S else 0.0
            if abs(self._ahead_s - known_s) > _TOLERATED_S and answer.status == 400:
                answer = self.call(json.dumps(make()), _PATH)
        return self.status_of(answer)
