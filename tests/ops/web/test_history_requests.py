"""Requests for past alerts and silences; test_interface.py has the answers, and adds silences through the API."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from typing import Mapping

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which serves the page, is not installed")

from robot_health_monitor.core.config.schema import read_record, read_texts
from robot_health_monitor.core.values.errors import MessageError
from robot_health_monitor.core.values.model import Level
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.store.silences import read_silences
from robot_health_monitor.ops.web.history_requests import (
    EndOfSilence,
    NewSilence,
    Query,
    expire_silence,
    new_silence,
)

EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def test_parameters_that_are_left_out_or_empty_do_not_limit() -> None:
    nothing = Query(None, None, None, None, None, 100, False)
    assert read_texts(Query, {}) == nothing
    assert (
        read_texts(Query, {"robot": "", "signal": "", "level": "", "since": "", "before": "", "limit": "", "open": ""})
        == nothing
    )


def test_every_parameter_is_read() -> None:
    given = {
        "robot": "r1",
        "signal": "b*",
        "level": "WARN",
        "since": "1970-01-01T00:01:00Z",
        "before": "7",
        "limit": "5",
        "open": "1",
    }
    assert read_texts(Query, given) == Query("r1", "b*", Level.WARN, EPOCH + timedelta(minutes=1), 7, 5, True)
    assert read_texts(Query, {"since": "1970-01-01T01:00:00+01:00"}).since == EPOCH
    assert read_texts(Query, {"since": "1970-01-01T00:01:00.500"}).since == EPOCH + timedelta(seconds=60.5)


@pytest.mark.parametrize(
    "given",
    [{"level": "warn"}, {"since": "x"}, {"since": "\ud800"}, {"limit": "-1"}, {"limit": "٣"}, {"before": "9" * 5000}],
)
def test_an_invalid_parameter_is_named(given: Mapping[str, str]) -> None:
    with pytest.raises(MessageError, match=f"^{next(iter(given))}: expected"):
        read_texts(Query, given)


def test_a_silence_is_shown_with_its_times() -> None:
    history = History(None, lambda: 60.0)
    silences = Silences(history)
    try:
        answer = new_silence(history, silences, read_record(NewSilence, {"robot": "*", "for_s": 60, "reason": None}))
        assert answer["silence"] == {
            "id": "1",
            "matchers": "robot=*",
            "reason": "",
            "author": "",
            "since": "1970-01-01T00:01:00.000Z",
            "until": "1970-01-01T00:02:00.000Z",
            "until_resolved": False,
            "every": None,
            "timezone": None,
            "in_force": True,
        }
        for bad in ({"id": 1, "author": "two\nlines"}, {"id": 1, "reason": 5}):
            with pytest.raises(MessageError, match=r"^(author|reason): expected"):
                expire_silence(silences, read_record(EndOfSilence, bad))
        assert expire_silence(silences, EndOfSilence(1, "replaced", "ben")) == {"ok": True}
        (stored,) = history.run(read_silences)
        assert (stored.ended_by, stored.ended_reason) == ("ben", "replaced")
        for bad in ({}, {"id": "one"}, {"id": -1}):
            with pytest.raises(MessageError):
                expire_silence(silences, read_record(EndOfSilence, bad))
    finally:
        history.close()
