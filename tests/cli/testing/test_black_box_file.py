"""What a black box has attached, and what is wrong with it in one line."""

from __future__ import annotations

from typing import Any

import pytest

from robot_health_monitor.cli.embedded import sections_of_nodes
from robot_health_monitor.cli.testing.past_alert import attached
from robot_health_monitor.core.judge.attachments import SavedMonitor
from robot_health_monitor.core.values.errors import ConfigError


class Opened:
    """Stands for opened recordings, whose formats are tested in test_mcap_file.py."""

    def __init__(self, **texts: str) -> None:
        self.paths = ["/box/r1.mcap"]
        self.attachments = {name.replace("_", "."): text for name, text in texts.items()}


def opened(**texts: str) -> Any:
    return Opened(**texts)


def test_a_recording_without_attachments_is_no_black_box() -> None:
    assert attached(opened()) == (None, None)


def test_the_thresholds_are_those_of_alert_system() -> None:
    text = "alert_system:\n  ros__parameters:\n    robot_name: r1\n    signals: {battery: {warn_below: 20.0}}\n"
    file, _ = attached(opened(thresholds_yaml=text))
    assert file is not None
    assert file.file == "/box/r1.mcap/thresholds.yaml"
    tree: dict[str, Any] = dict(sections_of_nodes(file)["alert_system"].tree)
    assert tree == {"robot_name": "r1", "signals": {"battery": {"warn_below": 20.0}}}


def test_the_states_are_those_at_the_beginning() -> None:
    saved = SavedMonitor("r1", 12.5, {"battery": {"since": {"announced": 3.0}}})
    assert attached(opened(state_json=saved.to_json())) == (None, saved)


@pytest.mark.parametrize(
    ("texts", "problem"),
    [
        ({"state_json": "{"}, "/box/r1.mcap: state.json: expected robot, time_s in seconds since 1970, and signals"),
        ({"thresholds_yaml": ""}, "/box/r1.mcap/thresholds.yaml: expected a mapping of keys to values, got nothing"),
    ],
)
def test_an_attachment_that_cannot_be_read_is_one_line(texts: dict[str, str], problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        attached(opened(**texts))
    assert str(caught.value) == problem
