"""The JSON of a notification, and addresses from ops.yaml and from files: nothing of a secret is shown."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from harness.transitions import transition

from robot_health_monitor.core.nodes.outlets import json_line
from robot_health_monitor.ops.configuration import TargetSettings, shown
from robot_health_monitor.ops.notify.sender import DeliveryError, Notification
from robot_health_monitor.ops.notify.webhook import Webhook


def of_file(path: Path) -> Webhook:
    return Webhook(TargetSettings("chat", "webhook", url_file=str(path)))


@pytest.mark.parametrize(
    ("url", "text"),
    [
        ("https://chat.example/hooks/s3cret", "https://chat.example"),
        ("https://alice:s3cret@chat.example:8443", "https://chat.example:8443"),
        ("https://alice:s3/cret@chat.example", "https://..."),
        ("https://chat.example/hooks/a@s3cret", "https://..."),
        ("https://chat.example?s3cret", "https://chat.example"),
        ("https://chat.example\\s3cret", "https://chat.example"),
        ("slack://s3cret/s3cret", "slack://..."),
        ("s3cret", "an address without a scheme"),
    ],
)
def test_only_scheme_and_host_are_shown(url: str, text: str) -> None:
    assert shown(url) == text


def test_a_given_address_is_returned() -> None:
    address = Webhook(TargetSettings("pager", "alertmanager", url="http://10.0.0.2:9093"))
    assert address.http_address() == "http://10.0.0.2:9093" and address.place == "http://10.0.0.2:9093"


def test_a_file_is_read_each_time_and_only_its_host_is_shown(tmp_path: Path) -> None:
    file = tmp_path / "chat.url"
    file.write_text("# chat room\nhttps://chat.example/hooks/s3cret\n")
    file.chmod(0o600)
    address = of_file(file)
    assert address.place == str(file)
    assert address.http_address() == "https://chat.example/hooks/s3cret"
    assert (address.place, address.warning) == ("https://chat.example", "")
    file.write_text("https://chat.example/hooks/new")
    assert address.http_address() == "https://chat.example/hooks/new"


def test_a_file_that_others_may_read_is_a_warning_until_it_is_protected(tmp_path: Path) -> None:
    file = tmp_path / "chat.url"
    file.write_text("https://chat.example/hooks/s3cret")
    file.chmod(0o644)
    address = of_file(file)
    address.http_address()
    advice = "every user of this machine can read this address; protect it with chmod 600"
    assert address.warning == f"{file}: {advice}"
    file.chmod(0o640)
    address.http_address()
    assert address.warning == ""


@pytest.mark.parametrize(
    ("contents", "problem"),
    [
        ("", "expected an address, got an empty file"),
        ("s3cret", "expected one address, http://... or https://..., without blanks"),
        ("ftp://s3cret", "expected one address, http://... or https://..., without blanks"),
        ("http://s3cret:99999999", "expected one address, http://... or https://..., without blanks"),
        ("http://chat.example/s3 cret", "expected one address, http://... or https://..., without blanks"),
        ("http://a.example\nhttp://b.example", "expected one address, http://... or https://..., without blanks"),
        ("x" * 5000, "expected at most 4096 bytes, got more"),
    ],
)
def test_a_file_without_an_address_is_a_failure_that_shows_nothing_of_it(
    tmp_path: Path, contents: str, problem: str
) -> None:
    file = tmp_path / "chat.url"
    file.write_text(contents)
    address = of_file(file)
    with pytest.raises(DeliveryError) as caught:
        address.http_address()
    assert str(caught.value) == f"{file}: {problem}" and not caught.value.may_have_arrived
    assert "s3cret" not in address.place


def test_a_file_that_does_not_exist_is_a_failure(tmp_path: Path) -> None:
    with pytest.raises(DeliveryError, match=r"cannot be read: No such file or directory$"):
        of_file(tmp_path / "missing").http_address()


def test_a_named_pipe_does_not_hang(tmp_path: Path) -> None:
    os.mkfifo(str(tmp_path / "pipe"))
    with pytest.raises(DeliveryError, match=r"expected a file, got something else$"):
        of_file(tmp_path / "pipe").http_address()


def test_the_json_is_that_of_the_transition_with_kind_and_time() -> None:
    fields = json.loads(json_line(transition()))
    written = json.loads(Notification(fields, False, 1_700_000_000.5).as_json())
    assert fields["text"] == "battery_level WARN: 19.5 % is below 20 % (was OK for 312 s)"
    assert written == {
        **fields,
        "text": f"{fields['robot']}: {fields['text']}",
        "notification": "firing",
        "time": "2023-11-14T22:13:20.500Z",
    }
    resolved = json.loads(Notification(fields, True, 0.0, is_test=True).as_json())
    assert (resolved["notification"], resolved["test"]) == ("resolved", True)


def test_the_text_ends_with_the_hint_also_for_a_notification_stored_by_a_version_without_hints() -> None:
    fields = json.loads(
        json_line(transition(text="battery STALE: silent", robot="r3", hint="no publisher on /battery"))
    )
    written = json.loads(Notification(fields, False, 0.0).as_json())
    assert (written["text"], written["hint"]) == (
        "r3: battery STALE: silent [no publisher on /battery]",
        "no publisher on /battery",
    )
    del fields["hint"]
    assert Notification(fields, False, 0.0).text == "r3: battery STALE: silent"


@pytest.mark.parametrize(
    ("fields", "annotations"),
    [
        ({}, {}),
        ({"black_box": "r3.mcap", "link": "https://a/#7"}, {"black_box": "r3.mcap", "link": "https://a/#7"}),
        ({"what_to_do": "check the cable"}, {"what_to_do": "check the cable"}),
        ({"what_to_do": "https://wiki/cable"}, {"runbook_url": "https://wiki/cable"}),
    ],
)
def test_what_there_is_beside_the_line_of_an_alert(fields: dict[str, str], annotations: dict[str, str]) -> None:
    assert Notification({"black_box": "", **fields}, False, 0.0).annotations == annotations
