"""Silences as JSON; test_interface.py adds and expires them through the API."""

from __future__ import annotations

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which serves the page, is not installed")

from robot_health_monitor.ops.active_silences import Silences
from robot_health_monitor.ops.history.history import History
from robot_health_monitor.ops.silences import read_silences
from robot_health_monitor.ops.web.requests import ApiError
from robot_health_monitor.ops.web.silence_requests import expire_silence, new_silence, silence_json


def test_a_silence_is_shown_with_its_times() -> None:
    history = History(None, lambda: 60.0)
    silences = Silences(history, None, lambda: 60.0)
    try:
        silence = new_silence(silences, {"robot": "*", "for_s": 60, "reason": None})
        assert silence_json(silence) == {
            "id": "1",
            "matchers": "robot=*",
            "reason": "",
            "author": "",
            "since": "1970-01-01T00:01:00.000Z",
            "until": "1970-01-01T00:02:00.000Z",
            "until_resolved": False,
        }
        for bad in ({"id": 1, "author": "two\nlines"}, {"id": 1, "reason": 5}):
            with pytest.raises(ApiError, match="reason"):
                expire_silence(silences, bad)
        assert expire_silence(silences, {"id": 1, "author": "ben", "reason": "replaced"}).id == 1
        (stored,) = history.run(read_silences)
        assert (stored.ended_by, stored.ended_reason) == ("ben", "replaced")
        for bad in ({}, {"id": "one"}, {"id": -1}):
            with pytest.raises(ApiError):
                expire_silence(silences, bad)
    finally:
        silences.close()
        history.close()
