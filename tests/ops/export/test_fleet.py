"""The files of a fleet: the tools that will read them accept them, and what they keep and take fits together."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from harness.promtool import needs_promtool, promtool
from harness.victoria_metrics import needs_victoria_metrics, vmalert_problem

from robot_health_monitor.core import ConfigError, load_config
from robot_health_monitor.ops.export.fleet import (
    FleetSettings,
    export_fleet,
    require_address,
    require_receiver,
    write_files,
)

RECEIVER = "https://centre.example.com:9090/api/v1/write"
AMTOOL, ANALYZE = shutil.which("amtool"), shutil.which("systemd-analyze")
THRESHOLDS = {"signals": {"battery_level": {"warn_below": 20.0, "keep_firing_for_s": 30.0}}}


def files(**changed: Any) -> dict[str, str]:
    settings = FleetSettings(RECEIVER, 86_400.0, 15.0, 900.0)._replace(**changed)
    return export_fleet(settings, load_config(THRESHOLDS), ["r1"])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in files().items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def problem(*command: str) -> str:
    """Returns what a tool prints about a file; empty: it accepts it."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    return "" if done.returncode == 0 else done.stdout + done.stderr


@needs_promtool
def test_promtool_accepts_the_configuration_and_the_rules_of_prometheus(folder: Path) -> None:
    assert promtool(folder, "check", "config", "centre/prometheus.yml") == ""
    assert promtool(folder, "check", "config", "--agent", "--syntax-only", "robot/agent.yml") == ""
    assert promtool(folder, "check", "rules", "--lint-fatal", "centre/rules.yaml") == ""


@pytest.mark.skipif(AMTOOL is None, reason="amtool is not installed (Debian's package prometheus-alertmanager)")
def test_amtool_accepts_the_configuration_of_alertmanager(folder: Path) -> None:
    assert problem("amtool", "check-config", str(folder / "centre/alertmanager.yml")) == ""


@needs_victoria_metrics
def test_vmagent_and_vmalert_accept_their_files(folder: Path) -> None:
    assert vmalert_problem(folder / "centre/rules.yaml") == ""
    assert problem("vmagent", "-dryRun", f"-promscrape.config={folder / 'robot/vmagent.yml'}") == ""


@needs_victoria_metrics
@pytest.mark.parametrize("unit", ["robot/robot-health-vmagent", "centre/robot-health-victoria-metrics"])
def test_every_flag_of_a_unit_exists(folder: Path, unit: str) -> None:
    command = re.search(r"ExecStart=(\S+) ((?:.|\\\n)*?)\nExec", (folder / f"{unit}.service").read_text())
    assert command is not None
    usage = subprocess.run([command[1], "-help"], capture_output=True, text=True, check=False, timeout=60)
    known = set(re.findall(r"^  -(\S+)", usage.stdout + usage.stderr, re.MULTILINE))
    assert {flag.split("=")[0][1:] for flag in command[2].split() if flag != "\\"} <= known


@needs_promtool
@pytest.mark.skipif(ANALYZE is None, reason="systemd-analyze is not installed")
@pytest.mark.parametrize("url", [RECEIVER, "http://127.0.0.1/api/v1/write"])
def test_systemd_accepts_the_units(tmp_path: Path, url: str) -> None:
    for name, text in files(receiver=url).items():
        if name.endswith(".service"):
            unit = tmp_path / Path(name).name
            unit.write_text(re.sub(r"ExecStart=\S+", "ExecStart=/bin/true", text))  # it looks for the executable
            assert "robot-health" not in problem("systemd-analyze", "verify", str(unit))


@pytest.mark.parametrize(("outage_s", "kept", "taken"), [(86_400.0, "25h", "28h"), (5_400.0, "150m", "330m")])
def test_the_centre_takes_all_that_an_agent_keeps(outage_s: float, kept: str, taken: str) -> None:
    written = files(outage_s=outage_s)

    assert f"--storage.agent.retention.max-time={kept} " in written["robot/robot-health-agent.service"]
    assert yaml.safe_load(written["centre/prometheus.yml"])["storage"]["tsdb"]["out_of_order_time_window"] == taken


def test_an_agent_scrapes_the_lean_profile_of_its_monitors_and_sends_only_that() -> None:
    written = files(monitors=["127.0.0.1:9001", "[::1]:9002"])

    for name in ("robot/agent.yml", "robot/vmagent.yml"):
        found = yaml.safe_load(written[name])
        (job,) = found["scrape_configs"]
        assert job["params"] == {"profile": ["fleet"]}
        assert job["static_configs"] == [{"targets": ["127.0.0.1:9001", "[::1]:9002"]}]
    (sent,) = yaml.safe_load(written["robot/agent.yml"])["remote_write"]
    assert sent["url"] == RECEIVER
    assert sent["basic_auth"] == {"username": "robots", "password_file": "/etc/robot-health/receiver.password"}
    assert sent["write_relabel_configs"] == [
        {"source_labels": ["__name__"], "regex": "robot_health_.*", "action": "keep"}
    ]


@pytest.mark.parametrize("scheme", ["http", "https"])
def test_the_readme_fits_a_screen(scheme: str) -> None:
    lines = files(receiver=f"{scheme}://centre.example.com:9090/api/v1/write")["README.md"].splitlines()

    assert max(map(len, lines)) <= 100


def test_no_field_of_a_template_is_left(folder: Path) -> None:
    texts = {path.name: path.read_text() for path in folder.rglob("*") if path.is_file()}

    assert len(texts) == 13
    assert [name for name, text in texts.items() if re.search("@[A-Z_]+@", text)] == []


def test_the_dashboard_has_the_signals_of_the_thresholds(folder: Path) -> None:
    assert "battery_level" in (folder / "centre/dashboard.json").read_text()


@pytest.mark.parametrize("scheme", ["http", "https"])
def test_the_centre_listens_where_the_robots_push_to(scheme: str) -> None:
    written = files(receiver=f"{scheme}://centre/api/v1/write")

    port = {"http": ":80", "https": ":443"}[scheme]
    assert f"--web.listen-address={port} " in written["centre/robot-health-prometheus.service"]
    assert f"-httpListenAddr={port} " in written["centre/robot-health-victoria-metrics.service"]
    assert ("-tlsCertFile" in written["centre/robot-health-victoria-metrics.service"]) == (scheme == "https")


@pytest.mark.parametrize(
    "url",
    [
        "",
        "centre:9090",
        "https://centre:9090",
        "https://centre:9090/",
        "ftp://centre/write",
        "https://robots:secret@centre/write",
        "https://centre:70000/write",
        "https://centre/write?a=b",
        "https://centre/%n",
        "https://centre/a b",
        "https://centre/write\nUser=root",
        "robots:secret@centre:9090/write",
        "https://robots:a/secret@centre/write",
        "https://centre/write?token=secret",
        "https://centre/write#secret",
        "https://[zz]:9090/write",
        "https://.../write",
        "https://centre:/write",
    ],
)
def test_a_receiver_that_is_no_full_url_or_has_a_password_is_refused(url: str) -> None:
    with pytest.raises(ConfigError, match="expected the URL of a receiver in full") as caught:
        require_receiver(url)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("address", ["", "host", "host:0", "host:70000", 'a"b:1', "host:1\n"])
def test_a_monitor_that_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(ConfigError, match="expected host:port of a monitor"):
        require_address(address)


@pytest.mark.parametrize("url", ["http://[::1]:9090/api/v1/write", "https://centre_1/w", "http://10.0.0.1/a-b/~c/"])
def test_a_receiver_is_an_address_or_a_name(url: str) -> None:
    assert require_receiver(url) == url


def test_a_silence_shorter_than_four_intervals_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"after 1m \(4 intervals\) to 168h of silence, got 59s$"):
        files(silent_after_s=59.0)


def test_a_silence_that_would_never_be_an_alert_is_refused() -> None:
    """Without a fleet.yaml, a robot is forgotten a day after it last reported."""
    assert "> 604800" in files(silent_after_s=7 * 86_400.0)["centre/rules.yaml"]
    with pytest.raises(ConfigError, match=r"an alert after 1m \(4 intervals\) to 168h of silence, got 169h$"):
        files(silent_after_s=169 * 3600.0)
    settings = FleetSettings(RECEIVER, 86_400.0, 15.0, 12 * 3600.0)
    config = load_config(THRESHOLDS)
    assert "> 43200" in export_fleet(settings, config)["centre/rules.yaml"]
    with pytest.raises(ConfigError, match=r"to 12h of silence, got 13h: without a fleet\.yaml, "):
        export_fleet(settings._replace(silent_after_s=13 * 3600.0), config)


def test_an_interval_at_which_a_series_ends_between_two_scrapes_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"expected an interval from 0\.1 to 120 s, got 300 s"):
        files(interval_s=300.0, silent_after_s=7200.0)


@pytest.mark.parametrize(("outage_d", "kept"), [(1, "30d"), (29, "30d"), (30, "31d"), (90, "91d")])
def test_the_centre_keeps_samples_for_longer_than_an_agent_may_be_cut_off(outage_d: int, kept: str) -> None:
    written = files(outage_s=outage_d * 86_400.0)

    assert f"--storage.tsdb.retention.time={kept}\n" in written["centre/robot-health-prometheus.service"]
    assert f"-retentionPeriod={kept} " in written["centre/robot-health-victoria-metrics.service"]


MADE = "Made by robot-health export fleet."


def test_files_replace_those_of_an_earlier_export(tmp_path: Path) -> None:
    write_files(str(tmp_path / "out"), {"robot/a.yml": "old", "README.md": f"{MADE} Old."})
    write_files(str(tmp_path / "out"), {"robot/a.yml": "new", "README.md": f"{MADE} New."})

    written = {str(path.relative_to(tmp_path)): path.read_text() for path in tmp_path.rglob("*") if path.is_file()}
    assert written == {"out/robot/a.yml": "new", "out/README.md": f"{MADE} New."}


def test_the_readme_of_a_project_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("# My robots\n")

    with pytest.raises(ConfigError, match=r"README\.md: is not from an earlier export; expected another folder"):
        write_files(str(tmp_path), {"robot/a.yml": "new", "README.md": f"{MADE} New."})

    assert [file.name for file in tmp_path.rglob("*")] == ["README.md"]
    assert (tmp_path / "README.md").read_text() == "# My robots\n"


def test_an_empty_folder_name_is_refused_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    with pytest.raises(ConfigError, match="expected a folder, got ''"):
        write_files("", {"robot/a.yml": "new", "README.md": MADE})
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")

    with pytest.raises(ConfigError, match=r"out/README\.md: cannot be written: "):
        write_files(str(tmp_path / "out"), {"README.md": ""})
