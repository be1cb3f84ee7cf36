"""Rules for vmalert: its own check accepts them, and they contain the conditions of the rules for Prometheus."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping

import pytest
import yaml
from harness.victoria_metrics import needs_victoria_metrics, vmalert_problem

from robot_health_monitor.core import load_config
from robot_health_monitor.ops.export.prometheus import export_rules
from robot_health_monitor.ops.export.vmalert import for_vmalert

ROOT = Path(__file__).resolve().parents[3]
THRESHOLDS = sorted(path.name for path in (ROOT / "config").glob("*.yaml") if "ros__parameters" in path.read_text())


def rewritten(signals: Mapping[str, Any], interval_s: float = 15.0) -> str:
    return for_vmalert(export_rules(load_config({"signals": signals}), interval_s=interval_s).text)


@needs_victoria_metrics
@pytest.mark.parametrize("file", THRESHOLDS)
def test_vmalert_accepts_the_rules_of_every_shipped_configuration(tmp_path: Path, file: str) -> None:
    rules = tmp_path / "rules.vm.yaml"
    rules.write_text(for_vmalert(export_rules(load_config(ROOT / "config" / file)).text))

    assert vmalert_problem(rules) == ""


@needs_victoria_metrics
def test_vmalert_refuses_the_rules_of_prometheus_because_of_keep_firing_for(tmp_path: Path) -> None:
    rules = tmp_path / "rules.yaml"
    rules.write_text(export_rules(load_config({"signals": {"a": {"warn_below": 1.0, "keep_firing_for_s": 5.0}}})).text)

    assert "keep_firing_for" in vmalert_problem(rules)


@needs_victoria_metrics
def test_vmalert_accepts_odd_texts(tmp_path: Path) -> None:
    rules = tmp_path / "rules.vm.yaml"
    rules.write_text(rewritten({"a": {"warn_below": 1e300, "unit": '"{{ x }}" µ\\', "keep_firing_for_s": 0.5}}))

    assert vmalert_problem(rules) == ""


@pytest.mark.parametrize("name", ["null", "on", "no"])
def test_the_name_of_a_signal_stays_a_text(name: str) -> None:
    text = rewritten({name: {"warn_below": 20.0, "hysteresis": 1.0, "keep_firing_for_s": 0.5}})

    rules = [rule for group in yaml.safe_load(text)["groups"] for rule in group["rules"]]
    labels = [rule.get("labels", {}).get("signal", name) for rule in rules]
    assert set(labels) == {name, "link", "monitor"} and labels.count(name) > 2


def test_a_condition_counts_for_its_time_after_the_first_evaluation_at_which_it_no_longer_holds() -> None:
    text = rewritten({"a": {"warn_below": 20.0, "for_s": 30.0, "keep_firing_for_s": 60.0, "stale_after_s": 0.0}})

    rules = yaml.safe_load(text)["groups"][0]["rules"]
    recorded = next(rule for rule in rules if rule.get("record") == "robot_health:active")
    alert = next(rule for rule in rules if rule.get("labels", {}).get("level") == "WARN" and "alert" in rule)
    assert recorded["labels"]["level"] == "WARN"
    assert f'{{rule="{recorded["labels"]["rule"]}", level="WARN"}}[75s]' in alert["expr"]
    assert alert["expr"].startswith(f"({recorded['expr']})\nor on (robot, signal) (")
    assert alert["for"] == "30s" and "keep_firing_for" not in text.split("groups:")[1]


def test_rules_of_several_groups_do_not_read_each_other() -> None:
    one = export_rules(load_config({"signals": {"a": {"warn_below": 20.0, "keep_firing_for_s": 60.0}}})).text
    text = for_vmalert(one + one.split("groups:\n")[1].replace('"robot_health"', '"other"'))

    groups = yaml.safe_load(text)["groups"]
    numbers = [
        rule["labels"]["rule"]
        for group in groups
        for rule in group["rules"]
        if rule.get("record", "").endswith("active")
    ]
    assert len(numbers) == len(set(numbers)) and len(numbers) % 2 == 0 and numbers
