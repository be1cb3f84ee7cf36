"""Silences as JSON values: what pages show, and what they ask for."""

from __future__ import annotations

from typing import Any, Dict, Mapping

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.runtime.times import iso_time

from ..active_silences import Silences
from ..matchers import Matcher, matchers_text
from ..silences import Silence
from .requests import ApiError, read_text

__all__ = ["expire_silence", "new_silence", "silence_json"]


def silence_json(silence: Silence) -> Dict[str, Any]:
    """Returns a silence as docs/reference/api.md describes it."""
    return {
        "id": str(silence.id),
        "matchers": matchers_text(silence.matchers),
        "reason": silence.reason,
        "author": silence.author,
        "since": iso_time(silence.created_s),
        "until": None if silence.until_s is None else iso_time(silence.until_s),
        "until_resolved": silence.until_resolved,
    }


def new_silence(silences: Silences, body: Mapping[str, Any]) -> Silence:
    """Adds the silence that a request asks for. May block.

    Raises:
        ApiError: a value is missing or invalid.
        ConfigError: it is not possible.
        ServiceError: the history failed or did not answer.
    """
    robot, signal = read_text(body, "robot"), read_text(body, "signal")
    if not robot:
        raise ApiError(400, "robot: expected a name or a pattern, got nothing")
    matchers = [Matcher("robot", True, robot)] + ([Matcher("signal", True, signal)] if signal else [])
    for_s = body.get("for_s")
    if for_s is not None and (isinstance(for_s, bool) or not isinstance(for_s, (int, float))):
        raise ApiError(400, "for_s: expected a number of seconds")
    if for_s is not None and not 0 < for_s < 1e9:
        raise ApiError(400, "for_s: expected seconds above 0, at most a year")
    return silences.add(
        matchers,
        for_s=None if for_s is None else float(for_s),
        until_resolved=body.get("until_resolved") is True,
        reason=read_text(body, "reason"),
        author=read_text(body, "author"),
    )


def expire_silence(silences: Silences, body: Mapping[str, Any]) -> Silence:
    """Ends the silence that a request names. May block.

    Raises:
        ApiError: it is not named, there is no such silence, or it has ended.
        ServiceError: the history failed or did not answer.
    """
    text = str(body.get("id", ""))[:20]
    if not (text.isascii() and text.isdigit()):
        raise ApiError(400, "id: expected the id of a silence")
    reason, author = read_text(body, "reason"), read_text(body, "author")
    if not (reason + author).isprintable():
        raise ApiError(400, "expected a reason and an author of one line each")
    try:
        return silences.expire(int(text), reason=reason, author=author)
    except ConfigError as error:
        raise ApiError(404, error.problem) from None
