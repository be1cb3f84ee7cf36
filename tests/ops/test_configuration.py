"""ops.yaml: what it gives, and every mistake with file, line and key. The expected lines are written by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core import Level
from robot_health_monitor.core.config.yaml_file import YamlFile, read_yaml
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.ops.configuration import (
    BlackBoxSettings,
    HistorySettings,
    OpsConfig,
    ServerOptions,
    TargetSettings,
    read_ops,
    url_problem,
)

DESIGN = """\
history: {file: /var/lib/robot-health/history.db, keep_days: 90, keep_mb: 500}
notify:
  pager: {type: alertmanager, url: "http://10.0.0.2:9093", min_level: WARN}
  chat:  {type: webhook, url_file: /etc/robot-health/chat.url, min_level: ERROR}
  horn:  {type: command, command: [/usr/local/bin/horn], min_level: ERROR, timeout_s: 10}
  mail:  {type: apprise, url_file: /etc/robot-health/mail.url}
  alive: {type: heartbeat, url: "https://example.com/alive", every_s: 60}
server: {port: 9090, address: 127.0.0.1, token_file: "", tls_certificate: "", tls_key: "", allow_publish: [], \
allow_call: [], allow_offer: []}
"""


def read(folder: Path, text: str) -> OpsConfig:
    file = folder / "ops.yaml"
    file.write_text(text, encoding="utf-8")
    return read_ops(read_yaml(file))


def mistakes(folder: Path, text: str) -> list[str]:
    """Returns the lines of the error, without the name of the folder."""
    with pytest.raises(ConfigError) as caught:
        read(folder, text)
    return [str(error).replace(f"{folder}/", "") for error in caught.value.all]


def test_the_file_of_the_design_is_read(tmp_path: Path) -> None:
    assert read(tmp_path, DESIGN) == OpsConfig(
        HistorySettings("/var/lib/robot-health/history.db", 90.0, 500.0),
        (
            TargetSettings("pager", "alertmanager", Level.WARN, url="http://10.0.0.2:9093"),
            TargetSettings("chat", "webhook", Level.ERROR, url_file="/etc/robot-health/chat.url"),
            TargetSettings("horn", "command", Level.ERROR, command=("/usr/local/bin/horn",), timeout_s=10.0),
            TargetSettings("mail", "apprise", Level.WARN, url_file="/etc/robot-health/mail.url"),
            TargetSettings("alive", "heartbeat", url="https://example.com/alive", every_s=60.0),
        ),
        ServerOptions(9090, "127.0.0.1"),
    )


@pytest.mark.parametrize("section", ["history: {file: a.db}", "notify: {}", "server: {}"])
def test_every_section_is_optional(tmp_path: Path, section: str) -> None:
    assert read(tmp_path, section)


def test_a_black_box_is_read(tmp_path: Path) -> None:
    text = "black_box: {folder: bb, topics: [/imu, '/arm/*', '*'], before_s: 5, after_s: 0, min_level: STALE, "
    text += "memory_mb: 8, keep_mb: 100, keep_days: 3}"
    expected = BlackBoxSettings(f"{tmp_path}/bb", ("/imu", "/arm/*", "*"), 5.0, 0.0, Level.STALE, 8.0, 100.0, 3.0)
    assert read(tmp_path, text).black_box == expected
    assert read(tmp_path, "black_box: {folder: /bb}").black_box == BlackBoxSettings("/bb")


def test_every_mistake_of_a_black_box_is_reported(tmp_path: Path) -> None:
    text = "black_box:\n  topics: [imu, '/a b']\n  before_s: -1\n  min_level: OK\n  memory_mb: 0\n  keep_gb: 1\n"
    assert mistakes(tmp_path, text) == [
        "ops.yaml:1: black_box.folder: is missing; expected the path of the folder with the recordings, which is "
        "created",
        "ops.yaml:2: black_box.topics: expected absolute names of topics, such as /imu or /arm/*, got 'imu'",
        "ops.yaml:2: black_box.topics: expected absolute names of topics, such as /imu or /arm/*, got '/a b'",
        "ops.yaml:3: black_box.before_s: expected a number from 0 to 3600, got -1",
        "ops.yaml:4: black_box.min_level: expected one of WARN, STALE, ERROR, got 'OK'",
        "ops.yaml:5: black_box.memory_mb: expected a number from 1 to 100000, got 0",
        "ops.yaml:6: black_box.keep_gb: unknown key; did you mean keep_mb?",
    ]


def test_relative_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    config = read(
        tmp_path,
        "history: {file: data/../history.db}\n"
        "notify:\n"
        "  chat: {type: webhook, url_file: chat.url}\n"
        "  horn: {type: command, command: [./horn, ./loud]}\n"
        "  bell: {type: command, command: [bell]}\n"
        "server: {token_file: token, tls_certificate: tls/cert.pem, tls_key: /etc/key.pem}\n",
    )
    assert config.history == HistorySettings(f"{tmp_path}/history.db")
    chat, horn, bell = config.notify
    assert chat.url_file == f"{tmp_path}/chat.url"
    assert horn.command == (f"{tmp_path}/horn", "./loud")  # the arguments are left alone
    assert bell.command == ("bell",)  # from PATH
    assert config.server == ServerOptions(
        token_file=f"{tmp_path}/token", tls_certificate=f"{tmp_path}/tls/cert.pem", tls_key="/etc/key.pem"
    )


def test_the_home_directory_may_be_written_as_a_tilde(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/ada")
    assert read(tmp_path, "history: {file: ~/history.db}").history == HistorySettings("/home/ada/history.db")


HTTP = "http://host:port or https://host:port, without user, password and blanks"
WRONG = """\
history:
  file: history.db
  keep_days: -1
  keep_gb: 3
notfy: {}
notify:
  pager: {type: alertmanger, url: "http://10.0.0.2:9093"}
  both: {type: webhook, url: "http://a", url_file: b}
  neither: {type: webhook, min_level: WARN}
  ftp:
    type: webhook
    url: ftp://files/abc
    min_level: warn
  horn: {type: command, command: /usr/local/bin/horn, url: "http://a"}
  alive: {type: heartbeat, url: "http://a", every_s: 5, timeout_s: 10, min_level: ERROR}
  "a b": {type: webhook, url: "http://a"}
  empty: {type: command, command: []}
  later: {url: "http://a"}
  list: [webhook]
server:
  port: 70000
  address: http://0.0.0.0
  tls_certificate: a.pem
  allow_publish: /cmd_vel
"""


def test_all_mistakes_are_reported_with_the_lines_of_their_keys(tmp_path: Path) -> None:
    types = "one of alertmanager, webhook, command, apprise, heartbeat"
    assert mistakes(tmp_path, WRONG) == [
        "ops.yaml:3: history.keep_days: expected a number from 0.01 to 36500, got -1",
        "ops.yaml:4: history.keep_gb: unknown key; did you mean keep_mb?",
        "ops.yaml:5: notfy: unknown key; did you mean notify?",
        f"ops.yaml:7: notify.pager.type: expected {types}, got 'alertmanger'",
        "ops.yaml:8: notify.both: expected either url or url_file, got both",
        "ops.yaml:9: notify.neither: expected either url or url_file, got neither",
        f"ops.yaml:12: notify.ftp.url: expected {HTTP}, got ftp://...",
        "ops.yaml:13: notify.ftp.min_level: expected one of WARN, STALE, ERROR, got 'warn'",
        "ops.yaml:14: notify.horn.command: expected a list of texts, got '/usr/local/bin/horn'",
        "ops.yaml:14: notify.horn.url: not a key of a target of type command; expected one of type, "
        "min_level, command, robots, signals, simulated, timeout_s, group_wait_s, after_s",
        "ops.yaml:15: notify.alive.min_level: not a key of a target of type heartbeat; expected one of type, url, "
        "url_file, timeout_s, every_s",
        "ops.yaml:16: notify.a b: expected a name of at most 64 letters, digits, _, . and -",
        "ops.yaml:17: notify.empty.command: expected a program and its arguments, got nothing",
        f"ops.yaml:18: notify.later.type: is missing; expected {types}",
        "ops.yaml:19: notify.list: expected a mapping of keys to values, got ['webhook']",
        "ops.yaml:20: server: expected tls_certificate and tls_key, got one of them",
        "ops.yaml:21: server.port: expected a whole number from 0 to 65535, got 70000",
        "ops.yaml:22: server.address: expected an IP address or the name of a host, got 'http://0.0.0.0'",
        "ops.yaml:24: server.allow_publish: expected a list of texts that are not empty, got '/cmd_vel'",
    ]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("history: {}", "ops.yaml:1: history.file: is missing; expected the path of the SQLite file, which is created"),
        ("history:", "ops.yaml:1: history: expected a mapping of keys to values, got nothing"),
        ("history: {file: 3}", "ops.yaml:1: history.file: expected printable text, got 3; quote it"),
        (
            "history: {file: a, keep_mb: .nan}",
            "ops.yaml:1: history.keep_mb: expected a number from 1 to 1000000, got nan",
        ),
        ("notify: [a]", "ops.yaml:1: notify: expected a mapping of keys to values, got ['a']"),
        (
            "notify: {a: {type: webhook, url: 'http://a', robots: ['']}}",
            "ops.yaml:1: notify.a.robots: expected a list of texts that are not empty, got ['']",
        ),
        (
            "notify: {a: {type: webhook, url: 'http://ada:secret@a'}}",
            f"ops.yaml:1: notify.a.url: expected {HTTP}, got http://a",
        ),
        (
            "notify: {a: {type: webhook, url: [secret]}}",
            "ops.yaml:1: notify.a.url: expected printable text, got something else",
        ),
        (
            'notify: {a: {type: webhook, url: "http://secret\\n"}}',
            "ops.yaml:1: notify.a.url: expected printable text, got something else",
        ),
        (
            "server: {address: 'http://0.0.0.0'}",
            "ops.yaml:1: server.address: expected an IP address or the name of a host, got 'http://0.0.0.0'",
        ),
        ("server: {tls_key: a}", "ops.yaml:1: server: expected tls_certificate and tls_key, got one of them"),
        (
            "server: {allow_call: [/reset, ' ']}",
            "ops.yaml:1: server.allow_call: expected a list of texts that are not empty, got ['/reset', ' ']",
        ),
    ],
)  # fmt: skip
def test_one_mistake(tmp_path: Path, text: str, line: str) -> None:
    assert mistakes(tmp_path, text) == [line]


def test_more_targets_than_the_limit_are_refused(tmp_path: Path) -> None:
    targets = "".join(f"  t{number}: {{type: webhook, url: 'http://a'}}\n" for number in range(51))
    assert mistakes(tmp_path, f"notify:\n{targets}") == ["ops.yaml:1: notify: expected at most 50 targets, got 51"]


@pytest.mark.parametrize(
    "url",
    ["http://10.0.0.2:9093", "https://alerts.example.com/prefix", "http://[::1]:9093", "http://alertmanager"],
)
def test_addresses_that_may_be_alertmanagers(url: str) -> None:
    assert url_problem(url, "alertmanager") == ""


@pytest.mark.parametrize(
    ("url", "type_name", "problem"),
    [
        ("10.0.0.2:9093", "alertmanager", f"{HTTP}, ? and #, got an address without a scheme"),
        ("http://", "alertmanager", f"{HTTP}, ? and #, got http://"),
        ("http://a/?key=secret", "alertmanager", f"{HTTP}, ? and #, got http://a"),
        ("http://host:99999", "webhook", f"{HTTP}, got http://host:99999"),
        ("http://host:0", "webhook", f"{HTTP}, got http://host:0"),
        ("http://[::1", "webhook", f"{HTTP}, got http://[::1"),
        ("http://a/b c", "webhook", f"{HTTP}, got http://a"),
        ("http://ada:secret@a", "webhook", f"{HTTP}, got http://a"),
        ("file:///etc/secret", "heartbeat", f"{HTTP}, got file://..."),
        ("slack://secret/token", "webhook", f"{HTTP}, got slack://..."),
        (
            "slack://secret/a token",
            "apprise",
            "an address of Apprise, such as mailtos://user:password@host, got slack://...",
        ),
        (
            "mailto:ada@a",
            "apprise",
            "an address of Apprise, such as mailtos://user:password@host, got an address without a scheme",
        ),
    ],
)
def test_addresses_that_cannot_be_used_are_refused_without_their_secrets(
    url: str, type_name: str, problem: str
) -> None:
    assert url_problem(url, type_name) == f"expected {problem}"


def test_an_address_is_not_shown_with_its_target() -> None:
    assert "secret" not in repr(TargetSettings("chat", "webhook", url="https://example.com/secret"))


_KEYS = st.sampled_from(
    ["history", "notify", "server", "file", "type", "url", "url_file", "command", "robots", "port", "tls_key"]
)
_LEAVES = st.sampled_from(
    [None, True, -1, 10**400, float("nan"), "", "a", "\n", "http://a", "webhook", "heartbeat", "command", ["a"], {}]
)
_TARGETS = st.dictionaries(_KEYS, _LEAVES | st.dictionaries(_KEYS, _LEAVES, max_size=4), max_size=3)


@given(st.dictionaries(_KEYS, _LEAVES | _TARGETS, max_size=4))
def test_any_mapping_is_read_or_refused(tree: dict[str, Any]) -> None:
    file = YamlFile(tree, {}, "ops.yaml")
    try:
        config: OpsConfig | None = read_ops(file)
    except ConfigError:
        config = None
    assert config is None or (config == read_ops(file) and set(tree) <= {"history", "notify", "server"})
