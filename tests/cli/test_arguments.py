"""The command line of `robot-health`: its commands, what is accepted, and the one line for what is not."""

from __future__ import annotations

import argparse
import ast
import subprocess
import sys
from pathlib import Path

import pytest

import robot_health_monitor
from robot_health_monitor.cli.arguments import (
    COMMANDS,
    duration,
    find_installed,
    identifier,
    namespace,
    parse,
    port,
    seconds,
)
from robot_health_monitor.core.values.version import package_version

FOLDER = Path(robot_health_monitor.__file__).parent / "cli" / "commands"
MODULES = {path.stem[: -len("_command")]: path for path in FOLDER.glob("*_command.py")}

_WITHOUT_LIBRARIES = """
import sys
LIBRARIES = "aiohttp cbor2 lz4 mcap psutil rich rosbags yaml zstandard".split()
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in LIBRARIES:
            raise ModuleNotFoundError(name=name)
sys.meta_path.insert(0, Missing())
from robot_health_monitor.__main__ import main
code = main(sys.argv[1:])
print(*[name for name in sys.modules if name.endswith("_command")])
sys.exit(code)
"""


def test_every_module_of_a_command_is_a_command() -> None:
    assert sorted(MODULES) == sorted(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_defines_its_arguments_and_its_run(name: str) -> None:
    tree = ast.parse(MODULES[name].read_text(encoding="utf-8"))
    functions = {
        node.name: [argument.arg for argument in node.args.args]
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
    }
    assert functions["add_arguments"] == ["parser"]
    assert functions["run"] == ["arguments", "interrupts"]


@pytest.mark.parametrize("name", COMMANDS)
def test_no_command_imports_another(name: str) -> None:
    tree = ast.parse(MODULES[name].read_text(encoding="utf-8"))
    imported = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert [module for module in imported if module.endswith(("_command", "__main__"))] == []


@pytest.mark.parametrize("words", [[], *([name] for name in COMMANDS)], ids=lambda words: "-".join(words) or "all")
def test_help_needs_no_library_and_no_other_command(words: list[str], environment: dict[str, str]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _WITHOUT_LIBRARIES, *words, "--help"],
        capture_output=True, text=True, env=environment, timeout=60.0, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1].split() == [
        f"robot_health_monitor.cli.commands.{name}_command" for name in words
    ]


def test_run_watches_with_defaults() -> None:
    arguments = parse(["run"])
    assert (arguments.command, arguments.json, arguments.duration) == ("run", False, None)
    assert (arguments.thresholds, arguments.port, arguments.log_level) == (None, None, "INFO")


def test_levels_of_the_log_are_accepted_in_lower_case() -> None:
    assert parse(["run", "--log-level", "debug"]).log_level == "DEBUG"


@pytest.mark.parametrize(("text", "ago_s"), [("90s", 90.0), ("1h30m", 5400.0), ("2w1d", 1_296_000.0)])
def test_times_may_be_durations(text: str, ago_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.time", lambda: 2e9)
    assert parse(["history", "--since", text]).since_s == 2e9 - ago_s


def test_options_may_be_repeated_where_they_are_lists() -> None:
    arguments = parse(["run", "--allow-publish", "/cmd_*", "--allow-publish", "/goal"])
    assert arguments.allow_publish == ["/cmd_*", "/goal"]


def test_connect_takes_several_addresses() -> None:
    assert parse(["connect", "ws://a:1", "b=ws://b:2"]).urls == ["ws://a:1", "b=ws://b:2"]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["run", "--port", "70000"], "--port"),
        (["run", "--port", "-1"], "--port"),
        (["run", "--duration", "0"], "--duration"),
        (["run", "--duration", "nan"], "--duration"),
        (["run", "--source", "imagined"], "--source"),
        (["run", "--robot", "a\nb"], r"robot-health run: argument --robot: expected printable text, got 'a\nb'; see"),
        (["run", "--jso"], "robot-health run: unrecognized arguments: --jso; see robot-health run --help"),
        (["silence", "list", "--jso"], "robot-health silence list: unrecognized arguments: --jso; see"),
        (["connect"], "robot-health connect: expected the URL of a robot, or --fleet FILE; see robot-health connect"),
        (["connect", "ws://a:1", "--namespace", "a b"], "such as carter or fleet/carter, got 'a b'"),
        (["connect", "a:1", "--token-file", "t"], "unrecognized arguments: --token-file"),
        (["replay", "x.bag", "--namespace", "7up"], "--namespace"),
        (["history", "--summary", "--alert", "1"], "--alert: not allowed with argument --summary"),
        (
            ["silence", "add", "robot=r3"],
            "robot-health silence add: expected --for TIME, --until-resolved or --every RULE, got neither",
        ),
        (["check"], "FILE"),
        (["fly"], "fly"),
    ],
)
def test_wrong_usage_is_one_line_and_code_2(words: list[str], line: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        parse(words)
    written = capsys.readouterr().err
    assert end.value.code == 2
    assert line in written and written.count("\n") == 1
    assert "--help" in written


@pytest.mark.parametrize(("command", "option"), [("run", "--token-file"), ("connect", "--robot-token-file")])
def test_a_token_is_refused_without_being_repeated(
    command: str, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        parse([command, "--token", "secret-7"])
    written = capsys.readouterr().err
    assert end.value.code == 2
    assert f"use {option} or ROBOT_HEALTH_TOKEN" in written and "secret-7" not in written


def test_control_characters_of_an_argument_are_not_written(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parse(["run", "--source", "\x1b[2Jcleared\nforged"])
    written = capsys.readouterr().err
    assert "\x1b" not in written and written.count("\n") == 1


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        parse(["--version"])
    assert end.value.code in (0, None)
    assert capsys.readouterr().out == f"robot-health {package_version()}\n"


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_a_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        parse([command, "--help"])
    assert end.value.code in (0, None)
    assert capsys.readouterr().out.startswith(f"usage: robot-health {command}")


def test_no_argument_at_all_shows_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        parse([])
    assert end.value.code == 0
    shown = capsys.readouterr().out
    assert shown.startswith("usage: robot-health ") and "connect" in shown and "replay" in shown


@pytest.mark.parametrize(("text", "number"), [("0", 0), ("9090", 9090), ("65535", 65535)])
def test_ports_are_whole_numbers_of_16_bits(text: str, number: int) -> None:
    assert port(text) == number


@pytest.mark.parametrize("text", ["", "-1", "65536", "1e3", "\u0664"])
def test_other_texts_are_no_ports(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="expected a whole number from 0 to 65535"):
        port(text)


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "1e9", "soon", ""])
def test_a_number_of_seconds_is_above_0_and_finite(text: str) -> None:
    assert seconds("0.5") == 0.5
    with pytest.raises(argparse.ArgumentTypeError, match="expected a number of seconds above 0"):
        seconds(text)


@pytest.mark.parametrize("text", ["", "x", "-1", "1.0", "1" * 19, "\u00b2"])
def test_an_identifier_is_a_whole_number(text: str) -> None:
    read = identifier("the id of a silence")
    assert read("17") == read("#17") == 17
    with pytest.raises(argparse.ArgumentTypeError, match="expected the id of a silence, got"):
        read(text)


def test_a_duration_has_units() -> None:
    assert duration("1h30m") == 5400.0
    with pytest.raises(argparse.ArgumentTypeError, match="expected a duration such as"):
        duration("90")


def test_a_namespace_has_words_and_slashes() -> None:
    assert namespace("fleet/carter") == "fleet/carter"
    with pytest.raises(argparse.ArgumentTypeError, match="expected a namespace such as carter"):
        namespace("a b")


def test_the_configuration_is_found() -> None:
    file = find_installed("config/thresholds.yaml")
    assert file is not None and file.is_file()


def test_a_file_that_does_not_exist_is_not_found() -> None:
    assert find_installed("config/no_such_file.yaml") is None


def test_the_help_has_every_command_in_one_of_four_groups(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parse(["--help"])
    lines = capsys.readouterr().out.splitlines()
    titles = [line for line in lines if line in ("Set up:", "Watch:", "Tune:", "Operate:")]
    shown = [line.split()[0] for line in lines if line.startswith("  ") and line.split()[0] in COMMANDS]
    assert len(titles) == 4 and sorted(shown) == sorted(COMMANDS)
    assert max(map(len, lines)) < 80
