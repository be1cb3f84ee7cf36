"""The configuration files of a fleet whose robots push: an agent on each robot, and a centre that stores and pages.

On a robot, Prometheus in agent mode or vmagent scrapes the monitor, keeps what it cannot send on its disk and pushes.
The centre is Prometheus, or VictoriaMetrics with vmalert; either notifies Alertmanager. No file contains a secret.
"""

from __future__ import annotations

import math
import re
from pathlib import PurePosixPath
from typing import Dict, List, NamedTuple, Optional, Sequence
from urllib.parse import urlsplit

from robot_health_monitor.core.errors import ConfigError

from ..notifications.alertmanager import ALERT
from .fleet_rules import EXPECTED_S, Judged, export_fleet_rules
from .prometheus import duration, require_interval
from .vmalert import for_vmalert

ROBOT_FOLDER, CENTRE_FOLDER = "/etc/robot-health", "/etc/robot-health-centre"
"""Where the files of a robot and of the centre are installed."""
_AGENT_MARGIN_S = 3600.0
_CENTRE_MARGIN_S = 4.0 * 3600.0
"""An agent truncates its log every 2 h: it may send samples older than its retention. Clocks may be wrong as well."""
_RETENTION_DAYS = 30
"""How long the centre keeps samples, at least; longer if an outage may be."""
_URL = re.compile(r"https?://(?:\w[\w.-]*|\[[0-9a-fA-F:.]+\])(?::\d{1,5})?(/[\w./~-]+)", re.ASCII)
_ADDRESS = re.compile(r"[\w.-]+:\d{1,5}|\[[0-9a-fA-F:]+\]:\d{1,5}", re.ASCII)
_LONGEST_SILENCE_S = 7.0 * 86_400.0
"""Rules count the evaluations of the centre over that time, which must be much shorter than its retention."""
_USER = "robots"
MADE = "Made by robot-health export fleet."
"""First words of README.md: what an earlier export has written may be replaced."""


class FleetSettings(NamedTuple):
    """What the files of both sides depend on."""

    receiver: str
    """URL that accepts remote write."""
    outage_s: float
    """Longest outage of a robot's network, or of the centre, after which every sample is still delivered."""
    interval_s: float
    """Between scrapes, and between evaluations of the rules."""
    silent_after_s: float
    """A robot that has not reported for this long is an alert."""
    monitors: Sequence[str] = ("127.0.0.1:9090",)
    """Addresses of the monitors that one agent scrapes."""


def require_receiver(url: str) -> str:
    """Returns the URL of a receiver; ConfigError: it is not one in full, or contains a password."""
    try:
        valid = _URL.fullmatch(url) is not None and urlsplit(url).port != 0
    except ValueError:
        valid = False  # a port above 65535
    if not valid:
        has_secret = any(each in url for each in "@?#")
        found = "without user, password and query" if has_secret else f"got {url[:100]!r}"
        raise ConfigError(f"expected the URL of a receiver in full, such as https://centre:9090/api/v1/write, {found}")
    return url


def require_address(address: str) -> str:
    """Returns `host:port`; ConfigError: it is none."""
    if not _ADDRESS.fullmatch(address) or not 0 < int(address.rpartition(":")[2]) < 65536:
        raise ConfigError(f"expected host:port of a monitor, got {address[:100]!r}")
    return address


class FleetExport(NamedTuple):
    """The files by their paths, and what their rules cannot express."""

    files: Dict[str, str]
    problems: Sequence[str]


def export_fleet(
    settings: FleetSettings, judged: Sequence[Judged], expected: Optional[Sequence[str]] = None
) -> FleetExport:
    """Returns the files of both sides; `expected` are the robots that must report, None: those that did."""
    require_interval(settings.interval_s)
    _require_silence(settings, expected is not None)
    rules = export_fleet_rules(judged, expected, interval_s=settings.interval_s, silent_after_s=settings.silent_after_s)
    files = {
        "robot/agent.yml": _agent(settings),
        "robot/vmagent.yml": _vmagent(settings),
        "robot/robot-health-agent.service": _agent_unit(settings),
        "robot/robot-health-vmagent.service": _vmagent_unit(settings),
        "centre/prometheus.yml": _prometheus(settings),
        "centre/rules.yaml": rules.text,
        "centre/rules.vm.yaml": for_vmalert(rules.text),
        "centre/alertmanager.yml": _alertmanager(),
        "centre/robot-health-prometheus.service": _prometheus_unit(settings),
        "centre/robot-health-alertmanager.service": _alertmanager_unit(),
        "centre/robot-health-victoria-metrics.service": _victoria_metrics_unit(settings),
        "centre/robot-health-vmalert.service": _vmalert_unit(settings),
        "README.md": _readme(settings, expected is not None),
    }
    return FleetExport(files, rules.problems)


def _require_silence(settings: FleetSettings, has_fleet_file: bool) -> None:
    """ConfigError: a silent robot would be an alert after a lost scrape, or never."""
    silent_after_s, least_s = settings.silent_after_s, 4.0 * settings.interval_s
    if silent_after_s < least_s:
        raise ConfigError(
            f"a robot must be silent for at least 4 intervals ({duration(least_s)}), got {duration(silent_after_s)}"
        )
    most_s = _LONGEST_SILENCE_S if has_fleet_file else EXPECTED_S / 2.0
    if silent_after_s > most_s:
        without = "" if has_fleet_file else ": without a fleet.yaml, it is expected for 24 h after it last reported"
        raise ConfigError(
            f"a robot must be an alert after at most {_hours(most_s)} of silence, got {_hours(silent_after_s)}{without}"
        )


def _retention(settings: FleetSettings) -> str:
    """Returns how long the centre keeps samples: never shorter than it takes them."""
    return f"{max(_RETENTION_DAYS, math.ceil((settings.outage_s + _CENTRE_MARGIN_S) / 86_400.0))}d"


def _is_tls(settings: FleetSettings) -> bool:
    return settings.receiver.startswith("https:")


def _port(settings: FleetSettings) -> int:
    """Returns the port on which the centre receives."""
    return urlsplit(settings.receiver).port or (443 if _is_tls(settings) else 80)


def _scrape(settings: FleetSettings) -> List[str]:
    """Returns the part that both agents read: only the monitor's metrics, all with the label `robot`."""
    targets = ", ".join(f'"{address}"' for address in settings.monitors)
    return [
        "scrape_configs:",
        "  - job_name: robot_health",
        "    params: {profile: [fleet]}",
        f"    # A monitor with a token: authorization: {{credentials_file: {ROBOT_FOLDER}/token}}",
        f"    static_configs: [{{targets: [{targets}]}}]",
        "    metric_relabel_configs:",
        "      - {source_labels: [__name__], regex: robot_health_.*, action: keep}",
    ]


def _agent(settings: FleetSettings) -> str:
    interval = duration(settings.interval_s)
    lines = [
        "# Prometheus in agent mode on a robot; the same file for all robots.",
        f"global: {{scrape_interval: {interval}, scrape_timeout: {duration(min(10.0, settings.interval_s))}}}",
        *_scrape(settings),
        "remote_write:",
        f"  - url: {settings.receiver}",
        f"    basic_auth: {{username: {_USER}, password_file: {ROBOT_FOLDER}/receiver.password}}",
        "    metadata_config: {send: false}",
        "    # Not `up` and the like: they have no label robot.",
        "    write_relabel_configs:",
        "      - {source_labels: [__name__], regex: robot_health_.*, action: keep}",
        "    queue_config: {capacity: 10000, max_samples_per_send: 2000, max_shards: 4, max_backoff: 30s}",
    ]
    return _text(lines)


def _vmagent(settings: FleetSettings) -> str:
    interval = duration(settings.interval_s)
    lines = [
        "# Scrapes of vmagent on a robot; the same file for all robots. Where it pushes to is in its unit.",
        f"global: {{scrape_interval: {interval}, scrape_timeout: {duration(min(10.0, settings.interval_s))}}}",
        *_scrape(settings),
    ]
    return _text(lines)


def _prometheus(settings: FleetSettings) -> str:
    interval = duration(settings.interval_s)
    lines = [
        "# Prometheus of the centre. The robots push to it: it scrapes nothing.",
        f"global: {{scrape_interval: {interval}, evaluation_interval: {interval}}}",
        "storage:",
        "  tsdb:",
        f"    # An outage of {_hours(settings.outage_s)}, and 4 h for truncation and clocks. An agent with older",
        "    # samples is refused with 500 and tries again for ever: never shorter than what an agent keeps.",
        f"    out_of_order_time_window: {_hours(settings.outage_s + _CENTRE_MARGIN_S)}",
        "rule_files: [rules.yaml]",
        'alerting: {alertmanagers: [{static_configs: [{targets: ["127.0.0.1:9093"]}]}]}',
    ]
    return _text(lines)


def _alertmanager() -> str:
    return f"""\
# Alertmanager of the centre: one notification per robot. Silent robots come in one, for all of them.
route:
  receiver: pager
  group_by: [robot]
  group_wait: 30s
  group_interval: 5m
  repeat_interval: 4h
  routes:
    - matchers: [alertname="{ALERT}", signal="monitor"]
      group_by: [alertname]
receivers:
  - name: pager
    pagerduty_configs:
      - routing_key_file: {CENTRE_FOLDER}/pager.key
inhibit_rules:
  - source_matchers: [alertname="{ALERT}", severity="critical"]
    target_matchers: [alertname="{ALERT}", severity="warning"]
    equal: [robot, signal]
"""


def _agent_unit(settings: FleetSettings) -> str:
    return _unit(
        "Robot Health Monitor: agent (Prometheus)",
        "robot-health",
        "robot-health-agent",
        [
            "/usr/bin/prometheus --enable-feature=agent",
            f"--config.file={ROBOT_FOLDER}/agent.yml",
            "--storage.agent.path=/var/lib/robot-health-agent",
            f"--storage.agent.retention.max-time={_hours(settings.outage_s + _AGENT_MARGIN_S)}",
            "--web.listen-address=127.0.0.1:9095",
        ],
        after="robot-health.service",
    )


def _vmagent_unit(settings: FleetSettings) -> str:
    return _unit(
        "Robot Health Monitor: agent (vmagent)",
        "robot-health",
        "robot-health-vmagent",
        [
            "/usr/bin/vmagent",
            f"-promscrape.config={ROBOT_FOLDER}/vmagent.yml",
            f"-remoteWrite.url={settings.receiver}",
            f"-remoteWrite.basicAuth.username={_USER}",
            f"-remoteWrite.basicAuth.passwordFile={ROBOT_FOLDER}/receiver.password",
            "-remoteWrite.tmpDataPath=/var/lib/robot-health-vmagent",
            "-remoteWrite.maxDiskUsagePerURL=1GB",
            "-remoteWrite.queues=1",
            "-httpListenAddr=127.0.0.1:8429",
        ],
        after="robot-health.service",
    )


def _prometheus_unit(settings: FleetSettings) -> str:
    return _unit(
        "Robot Health Monitor: centre (Prometheus)",
        "prometheus",
        "robot-health-prometheus",
        [
            "/usr/bin/prometheus --web.enable-remote-write-receiver",
            f"--config.file={CENTRE_FOLDER}/prometheus.yml",
            f"--web.config.file={CENTRE_FOLDER}/web.yml",
            f"--web.listen-address=:{_port(settings)}",
            "--storage.tsdb.path=/var/lib/robot-health-prometheus",
            f"--storage.tsdb.retention.time={_retention(settings)}",
        ],
        after="robot-health-alertmanager.service",
        binds_low_port=_port(settings) < 1024,
    )


def _alertmanager_unit() -> str:
    return _unit(
        "Robot Health Monitor: centre (Alertmanager)",
        "prometheus",
        "robot-health-alertmanager",
        [
            "/usr/bin/prometheus-alertmanager",
            f"--config.file={CENTRE_FOLDER}/alertmanager.yml",
            "--storage.path=/var/lib/robot-health-alertmanager",
            "--web.listen-address=127.0.0.1:9093 --cluster.listen-address=",
        ],
    )


def _victoria_metrics_unit(settings: FleetSettings) -> str:
    tls = [f"-tls -tlsCertFile={CENTRE_FOLDER}/tls.crt -tlsKeyFile={CENTRE_FOLDER}/tls.key"]
    return _unit(
        "Robot Health Monitor: centre (VictoriaMetrics)",
        "prometheus",
        "robot-health-victoria-metrics",
        [
            f"/usr/bin/victoria-metrics -envflag.enable -httpListenAddr=:{_port(settings)}",
            f"-storageDataPath=/var/lib/robot-health-victoria-metrics -retentionPeriod={_retention(settings)}",
            # A sample that an agent sends again counts once, and rules see what came a second ago.
            "-dedup.minScrapeInterval=1ms -search.latencyOffset=1s",
            *(tls if _is_tls(settings) else []),
        ],
        # httpAuth_username=robots and httpAuth_password=...: the environment of a process is its user's secret.
        environment_file=f"{CENTRE_FOLDER}/victoria-metrics.env",
        binds_low_port=_port(settings) < 1024,
    )


def _vmalert_unit(settings: FleetSettings) -> str:
    base = f"{urlsplit(settings.receiver).scheme}://{urlsplit(settings.receiver).netloc}"
    password = f"{CENTRE_FOLDER}/receiver.password"
    ends = [
        f"-{end}.url={base} -{end}.basicAuth.username={_USER} -{end}.basicAuth.passwordFile={password}"
        for end in ("datasource", "remoteWrite", "remoteRead")
    ]
    return _unit(
        "Robot Health Monitor: centre (vmalert)",
        "prometheus",
        "robot-health-vmalert",
        [
            f"/usr/bin/vmalert -rule={CENTRE_FOLDER}/rules.vm.yaml",
            *ends,
            "-remoteWrite.flushInterval=1s",
            f"-evaluationInterval={duration(settings.interval_s)} -notifier.url=http://127.0.0.1:9093",
            "-httpListenAddr=127.0.0.1:8880",
        ],
        after="robot-health-victoria-metrics.service robot-health-alertmanager.service",
    )


def _unit(
    description: str,
    user: str,
    state: str,
    command: Sequence[str],
    *,
    after: str = "",
    environment_file: str = "",
    binds_low_port: bool = False,
) -> str:
    """Returns a systemd unit."""
    lines = [
        "[Unit]",
        f"Description={description}",
        f"After=network.target time-sync.target {after}".rstrip(),
        "",
        "[Service]",
        "ExecStart=" + " \\\n  ".join(command),
        "ExecReload=/bin/kill -HUP $MAINPID",
        f"User={user}",
        f"StateDirectory={state}",
        *([f"EnvironmentFile={environment_file}"] if environment_file else []),
        "Restart=always",
        "RestartSec=5",
        "LimitNOFILE=65536",
        "NoNewPrivileges=yes",
        *(["AmbientCapabilities=CAP_NET_BIND_SERVICE"] if binds_low_port else []),
        f"CapabilityBoundingSet={'CAP_NET_BIND_SERVICE' if binds_low_port else ''}",
        "ProtectSystem=strict",
        "ProtectHome=yes",
        "PrivateTmp=yes",
        "PrivateDevices=yes",
        "RestrictAddressFamilies=AF_INET AF_INET6 AF_UNIX",
        "",
        "[Install]",
        "WantedBy=multi-user.target",
    ]
    return _text(lines)


def _readme(settings: FleetSettings, has_fleet_file: bool) -> str:
    tls = f"tls_server_config: {{cert_file: {CENTRE_FOLDER}/tls.crt, key_file: {CENTRE_FOLDER}/tls.key}}\\n"
    web = (tls if _is_tls(settings) else "") + 'basic_auth_users: {robots: "%s"}\\n'
    hashed = f"$(htpasswd -niBC 10 {_USER} < receiver.password | cut -d: -f2)"
    files = "a robot left the fleet" if has_fleet_file else "thresholds changed"
    certificate = f", {CENTRE_FOLDER}/tls.crt and tls.key" if _is_tls(settings) else ""
    name = PurePosixPath(CENTRE_FOLDER)
    lines = [
        f"{MADE} Outages up to {_hours(settings.outage_s)} lose nothing; docs/fleet.md says what others lose. "
        f"Each monitor has its own robot name and serves {', '.join(settings.monitors)}.",
        "1. Password, once: `(umask 077; openssl rand -hex 24 > receiver.password)`; "
        "hash: `apt-get install apache2-utils`. Then copy this folder to each machine, and run the commands in it, as "
        "root.",
        "2. Centre: `apt-get install prometheus prometheus-alertmanager && systemctl disable --now prometheus "
        f"prometheus-alertmanager && install -d -m 750 -g prometheus {name}`.",
        f"3. Centre: `install -m 640 -g prometheus centre/*.y*ml receiver.password {name}/`; further files that the "
        f"group prometheus can read: {name}/pager.key (routing key of the pager){certificate}.",
        f"4. Centre: `printf '{web}' \"{hashed}\" > {name}/web.yml && chmod 640 {name}/web.yml && "
        f"chgrp prometheus {name}/web.yml && promtool check web-config {name}/web.yml`.",
        "5. Centre: `install -m 644 centre/*.service /etc/systemd/system/ && systemctl daemon-reload && systemctl "
        "enable --now robot-health-alertmanager robot-health-prometheus`.",
        f"6. Or VictoriaMetrics (`apt-get install victoria-metrics`): `(umask 027; printf 'httpAuth_username={_USER}\\n"
        f'httpAuth_password=%s\\n\' "$(cat receiver.password)" > {name}/victoria-metrics.env)`, then `systemctl '
        "enable --now robot-health-alertmanager robot-health-victoria-metrics robot-health-vmalert`.",
        "7. Each robot: `apt-get install prometheus && systemctl disable --now prometheus && install -m 640 -g "
        f"robot-health robot/*.yml receiver.password {ROBOT_FOLDER}/ && install -m 644 robot/*.service "
        "/etc/systemd/system/`.",
        "8. Each robot: `systemctl daemon-reload && systemctl enable --now robot-health-agent`; a robot that is "
        "switched off while it is offline needs `victoria-metrics` and `robot-health-vmagent` instead.",
        f"9. When {files}: export again, install `centre/rules*.yaml` as in 3, `systemctl reload "
        "robot-health-prometheus` (or `robot-health-vmalert`).",
    ]
    return _text(lines)


def _text(lines: Sequence[str]) -> str:
    return "\n".join(lines) + "\n"


def _hours(seconds: float) -> str:
    """Returns a duration of whole seconds, in hours or minutes if it is a whole number of them."""
    for unit, size_s in (("h", 3600.0), ("m", 60.0)):
        if seconds % size_s == 0.0:
            return f"{seconds / size_s:.0f}{unit}"
    return duration(seconds)
