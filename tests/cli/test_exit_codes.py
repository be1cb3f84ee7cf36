"""The line about exit codes in the help of each command; test_main.py has the codes themselves."""

from __future__ import annotations

from robot_health_monitor.cli.arguments import COMMANDS
from robot_health_monitor.cli.exit_codes import exit_codes_text


def test_a_command_names_the_codes_that_it_can_end_with() -> None:
    assert exit_codes_text("check") == (
        "Exit codes: 0 success, 2 usage or configuration error, 3 the command itself failed, or a target of notify."
    )
    assert ", 1 alerts were found (replay, --duration) or a test failed, " in exit_codes_text("test")


def test_only_commands_that_judge_have_code_1() -> None:
    assert [name for name in COMMANDS if ", 1 " in exit_codes_text(name)] == ["run", "connect", "replay", "test"]
