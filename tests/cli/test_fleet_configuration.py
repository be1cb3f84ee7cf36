"""fleet.yaml: defaults, keys of single robots, and mistakes with file, line and key."""

from __future__ import annotations

import ssl
from pathlib import Path
from typing import Any

import pytest

from robot_health_monitor.cli.fleet_configuration import (
    Options,
    RobotEntry,
    RobotSettings,
    is_fleet_file,
    read_addresses,
    read_entries,
    read_robots,
)
from robot_health_monitor.core.config.yaml_file import read_yaml
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.runtime.tokens import TokenFiles

THRESHOLDS = "alert_system: {ros__parameters: {use_sim_time: SIM, signals: {battery_level: {warn_below: 20.0}}}}\n"


def entries(folder: Path, text: str) -> Any:
    file = folder / "fleet.yaml"
    file.write_text(text)
    return read_entries(read_yaml(file))


def mistakes(folder: Path, text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        entries(folder, text)
    return [str(error).replace(str(folder), "") for error in caught.value.all]


def read(folder: Path, options: Options = Options(), *addresses: RobotEntry) -> list[RobotSettings]:  # noqa: B008
    return read_robots(addresses, str(folder / "fleet.yaml"), options, TokenFiles(lambda text: None))


def test_a_robots_key_comes_before_the_default_and_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    husky, carter = entries(
        tmp_path,
        "defaults: {thresholds: thresholds.yaml, token_file: /etc/token, namespace: fleet}\n"
        "robots:\n"
        "  husky1: {url: 10.0.0.7:9090}\n"
        "  carter: {url: wss://10.0.0.8, namespace: carter, thresholds: sub/carter.yaml, ca: fleet.pem}\n",
    )
    assert (husky.name, husky.url, husky.namespace, husky.ca) == ("husky1", "ws://10.0.0.7:9090", "fleet", None)
    assert (husky.thresholds, husky.token_file) == (str(tmp_path / "thresholds.yaml"), "/etc/token")
    assert (carter.url, carter.namespace, carter.token_file) == ("wss://10.0.0.8", "carter", "/etc/token")
    assert (carter.thresholds, carter.ca) == (str(tmp_path / "sub/carter.yaml"), str(tmp_path / "fleet.pem"))


def test_an_empty_text_of_a_robot_replaces_the_default(tmp_path: Path) -> None:
    (robot,) = entries(tmp_path, 'defaults: {namespace: fleet}\nrobots: {a: {url: "ws://a", namespace: ""}}\n')
    assert robot.namespace == ""


def test_every_mistake_is_named_with_its_line(tmp_path: Path) -> None:
    text = (
        "defaults:\n"
        "  thresholds: 5\n"
        "  url: ws://all:9090\n"
        "robot: {}\n"
        "robots:\n"
        "  a: {url: http://a:9090}\n"
        "  'b c': {url: ws://b}\n"
        "  c: {}\n"
        "  d: {url: ws://d, tokenfile: x}\n"
        "  e: {url: ws://e, namespace: 'a b'}\n"
        "  f: ws://f\n"
    )
    assert mistakes(tmp_path, text) == [
        "/fleet.yaml:2: defaults.thresholds: expected printable text, got 5; quote it",
        "/fleet.yaml:3: defaults.url: unknown key; expected one of thresholds, namespace, token_file, ca",
        "/fleet.yaml:4: robot: unknown key; did you mean robots?",
        "/fleet.yaml:6: robots.a.url: expected ws://host:port, wss://host:port, foxglove://host:port or "
        "foxglove+tls://host:port, got 'http://a:9090'",
        "/fleet.yaml:7: robots.b c: expected a name of at most 64 letters, digits and _ . -, got 'b c'",
        "/fleet.yaml:8: robots.c: expected the address of its bridge, url: ws://host:port or foxglove://host:port",
        "/fleet.yaml:9: robots.d.tokenfile: unknown key; did you mean token_file?",
        "/fleet.yaml:10: robots.e.namespace: expected a namespace such as carter or fleet/carter, got 'a b'",
        "/fleet.yaml:11: robots.f: expected a mapping of keys to values, got 'ws://f'",
    ]


@pytest.mark.parametrize("text", ["robots: {}\n", "robots:\n", "defaults: {}\n", "robots: [a]\n"])
def test_a_file_without_robots_is_a_mistake(tmp_path: Path, text: str) -> None:
    (mistake,) = mistakes(tmp_path, text)
    assert "robots: expected" in mistake


@pytest.mark.parametrize("name", ["1", "yes", "2026-01-01"])
def test_a_name_that_yaml_reads_as_something_else_must_be_quoted(tmp_path: Path, name: str) -> None:
    assert "quote it" in mistakes(tmp_path, f"robots: {{{name}: {{url: 'ws://a'}}}}\n")[0]
    (robot,) = entries(tmp_path, f"robots: {{'{name}': {{url: 'ws://a'}}}}\n")
    assert robot.name == name


def test_a_url_with_a_password_is_shown_without_it(tmp_path: Path) -> None:
    (mistake,) = mistakes(tmp_path, "robots: {a: {url: 'ws://me:s3cret@host:99999'}}\n")
    assert "s3cret" not in mistake


def test_options_apply_where_the_file_says_nothing(tmp_path: Path) -> None:
    for name, sim in (("file.yaml", "true"), ("option.yaml", "false")):
        (tmp_path / name).write_text(THRESHOLDS.replace("SIM", sim))
    (tmp_path / "token").write_text("s3cret\n")
    (tmp_path / "fleet.yaml").write_text(
        "robots:\n  a: {url: ws://a}\n  b: {url: ws://b, thresholds: file.yaml, namespace: own}\n"
    )
    options = Options(str(tmp_path / "option.yaml"), "all", str(tmp_path / "token"))
    typed, a, b = read(tmp_path, options, RobotEntry(name="typed", url="ws://typed"))
    assert [(robot.name, robot.use_sim_time, robot.namespace, robot.token) for robot in (typed, a, b)] == [
        ("typed", False, "all", "s3cret"),
        ("a", False, "all", "s3cret"),
        ("b", True, "own", "s3cret"),
    ]
    assert "s3cret" not in repr(a)


def test_files_that_robots_share_are_read_once(tmp_path: Path) -> None:
    (tmp_path / "t.yaml").write_text(THRESHOLDS.replace("SIM", "false"))
    (tmp_path / "fleet.yaml").write_text(
        "defaults: {thresholds: t.yaml}\nrobots: {a: {url: 'ws://a'}, b: {url: 'ws://b'}}\n"
    )
    a, b = read(tmp_path)
    assert a.parameters is b.parameters


def test_a_mistake_in_a_thresholds_file_names_that_file(tmp_path: Path) -> None:
    (tmp_path / "t.yaml").write_text("alert_system:\n  ros__parameters:\n    signals: {a: {warn_belw: 1.0}}\n")
    (tmp_path / "fleet.yaml").write_text("robots: {a: {url: 'ws://a', thresholds: t.yaml}}\n")
    with pytest.raises(ConfigError, match=r"t\.yaml:3: .*warn_belw: unknown key"):
        read(tmp_path)


@pytest.mark.parametrize("key", ["thresholds", "token_file", "ca"])
def test_a_file_that_is_missing_is_named(tmp_path: Path, key: str) -> None:
    (tmp_path / "fleet.yaml").write_text(f"robots: {{a: {{url: 'ws://a', {key}: missing}}}}\n")
    with pytest.raises(ConfigError, match=r"missing: .*cannot be read"):
        read(tmp_path)


def test_robots_that_trust_the_same_authorities_share_the_settings(tmp_path: Path) -> None:
    paths = ssl.get_default_verify_paths()
    candidates = [paths.cafile, "/etc/ssl/certs/ca-certificates.crt"]
    file = next((name for name in candidates if name and Path(name).is_file()), None)
    if file is None:
        pytest.skip("this machine has no certificate authorities")
    (tmp_path / "fleet.yaml").write_text(
        f"defaults: {{ca: {file}}}\n"
        "robots: {a: {url: 'wss://a'}, b: {url: 'wss://b'}, c: {url: 'wss://c', ca: ''}}\n"
    )
    a, b, c = read(tmp_path)
    assert a.ssl_context is b.ssl_context is not None
    assert c.ssl_context is None and c.ca == b""
    again, *_ = read(tmp_path)
    assert again == a


def test_a_name_on_the_command_line_and_in_the_file_is_a_mistake(tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text("robots:\n  a: {url: ws://a}\n")
    with pytest.raises(ConfigError, match=r"fleet\.yaml:2: robots\.a: a robot of this name is on the command line"):
        read(tmp_path, Options(), RobotEntry(name="a", url="ws://other"))


def test_a_file_is_a_fleet_file_if_it_names_robots() -> None:
    assert is_fleet_file({"robots": {}})
    assert not is_fleet_file({"alert_system": {}, "robots": {}})
    assert not is_fleet_file({"history": {}})


def test_addresses_without_names_get_those_of_their_hosts() -> None:
    assert read_addresses(["ws://husky:9090", "ws://husky:9091", "r2=wss://10.0.0.1"]) == [
        RobotEntry(name="husky", url="ws://husky:9090"),
        RobotEntry(name="husky:9091", url="ws://husky:9091"),
        RobotEntry(name="r2", url="wss://10.0.0.1"),
    ]
