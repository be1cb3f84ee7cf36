"""A name that was renamed works until the next major version, with one warning that says what to write instead."""

from __future__ import annotations

import sys
import types
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Dict

import pytest

from robot_health_monitor.__main__ import main
from robot_health_monitor.core import load_config, signal_config
from robot_health_monitor.core.config import described_parameters
from robot_health_monitor.core.deprecation import RenamedWarning, former_names, shown_in_one_line, warn_renamed
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.parameters import Parameter, read_parameters

TABLE = (Parameter("period_s", float, 1.0, "period in s", 0.0, former="period"), Parameter("name", str, "", "a name"))


def test_a_former_key_is_read_as_the_present_one() -> None:
    with pytest.warns(RenamedWarning) as caught:
        assert read_parameters({"period": 5}, TABLE, ("node",)) == {"period_s": 5.0, "name": ""}
    assert [str(each.message) for each in caught] == [
        "node.period: renamed to period_s; the next major version refuses the former name"
    ]


def test_a_present_key_warns_of_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_parameters({"period_s": 5}, TABLE) == {"period_s": 5.0, "name": ""}


def test_an_empty_key_is_unknown_like_any_other() -> None:
    with pytest.raises(ConfigError, match="unknown key"):
        read_parameters({"": "atlas"}, TABLE)


def test_both_names_of_one_key_are_a_mistake() -> None:
    with pytest.raises(ConfigError, match=r"node\.period: renamed to period_s, which is given too; remove this key"):
        read_parameters({"period": 5, "period_s": 6}, TABLE, ("node",))


def test_a_wrong_value_of_a_former_key_is_refused_as_that_of_the_present_one() -> None:
    with pytest.warns(RenamedWarning), pytest.raises(ConfigError, match="period_s: expected a number of at least 0"):
        read_parameters({"period": -5}, TABLE)


def test_the_path_of_a_section_comes_before_both_names() -> None:
    below = TABLE[0].below("signals.wheel", default=2.0)
    assert (below.name, below.former, below.default) == ("signals.wheel.period_s", "signals.wheel.period", 2.0)
    assert TABLE[1].below("a").former == ""


@pytest.fixture
def renamed_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if `warn_below` had been `low` until now."""
    table = [
        replace(each, former="low") if each.name == "warn_below" else each for each in signal_config.SIGNAL_PARAMETERS
    ]
    monkeypatch.setattr(signal_config, "SIGNAL_PARAMETERS", tuple(table))


@pytest.mark.usefixtures("renamed_bound")
def test_a_configuration_of_an_earlier_version_still_means_the_same() -> None:
    with pytest.warns(RenamedWarning, match=r"^signals\.wheel\.low: renamed to warn_below"):
        config = load_config({"signals": {"wheel": {"low": 2.0}}})
    assert config.signals["wheel"].warn_below == 2.0
    assert "signals.wheel.low" not in [parameter.name for parameter in described_parameters(config)]


@pytest.mark.usefixtures("renamed_bound")
def test_check_names_file_and_line_of_a_former_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "thresholds.yaml"
    file.write_text("alert_system:\n  ros__parameters:\n    signals:\n      wheel:\n        low: 2.0\n")
    assert main(["check", str(file)]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[1:] == [
        f"{file}:5: alert_system.ros__parameters.signals.wheel.low: "
        "remark: renamed to warn_below; the next major version refuses the former name"
    ]
    assert err == ""


@pytest.mark.usefixtures("renamed_bound")
def test_a_command_warns_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "thresholds.yaml"
    file.write_text("alert_system: {ros__parameters: {signals: {wheel: {low: 2.0}}}}\n")
    with warnings.catch_warnings():  # pytest records warnings instead of showing them
        warnings.simplefilter("default")
        warnings.showwarning = lambda *each: sys.stderr.write(warnings.formatwarning(*each[:4]))  # type: ignore[assignment]
        assert main(["export", "prometheus", str(file)]) == 0
    warned = [line for line in capsys.readouterr().err.splitlines() if "renamed" in line]
    assert warned == [
        "robot-health: WARN: alert_system.ros__parameters.signals.wheel.low: "
        "renamed to warn_below; the next major version refuses the former name"
    ]


def test_other_warnings_look_as_usual() -> None:
    usual = warnings.formatwarning("text", UserWarning, "file.py", 3, "")
    with shown_in_one_line("robot-health"):
        assert warnings.formatwarning("text", UserWarning, "file.py", 3, "") == usual
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            warn_renamed("old\x1b[2J", "new")
        shown = warnings.formatwarning(caught[0].message, RenamedWarning, "file.py", 3)
    assert shown.startswith("robot-health: WARN: old") and "\x1b" not in shown and shown.count("\n") == 1
    assert warnings.formatwarning("text", UserWarning, "file.py", 3, "") == usual


def test_a_former_name_of_a_module_is_the_present_one(monkeypatch: pytest.MonkeyPatch) -> None:
    module = types.ModuleType("library")
    names: Dict[str, object] = {"Present": int, "__getattr__": former_names("library", {"Former": "Present"})}
    module.__dict__.update(names)
    monkeypatch.setitem(sys.modules, "library", module)
    with pytest.warns(RenamedWarning, match=r"^library\.Former: renamed to Present") as caught:
        assert module.Former is int
    assert caught[0].filename == __file__  # the place to change
    with pytest.raises(AttributeError, match="module 'library' has no attribute 'Other'"):
        _ = module.Other
