"""The configuration files of a fleet whose robots push: an agent on each robot, and a centre that stores and pages.

On a robot, Prometheus in agent mode or vmagent scrapes the monitor, keeps what it cannot send on its disk and pushes.
The centre is Prometheus, or VictoriaMetrics with vmalert; either notifies Alertmanager. The files are the templates in
`files/`. None contains a secret.
"""

from __future__ import annotations

import math
import os
import re
from typing import Mapping, NamedTuple, Sequence
from urllib.parse import urlsplit

from ...core.config import MonitorConfig
from ...core.values import ConfigError
from .grafana import export_dashboard
from .prometheus import EXPECTED_S, FILES, duration, export_fleet_rules, filled

_AGENT_MARGIN_S = 3600.0
_CENTRE_MARGIN_S = 4.0 * 3600.0
"""An agent truncates its log every 2 h: it may send samples older than its retention. Clocks may be wrong as well."""
_RETENTION_DAYS = 30
"""How long the centre keeps samples, at least; longer if an outage may be."""
_URL = re.compile(r"https?://(?:\w[\w.-]*|\[[0-9a-fA-F:.]+\])(?::\d{1,5})?(/[\w./~-]+)", re.ASCII)
_ADDRESS = re.compile(r"[\w.-]+:\d{1,5}|\[[0-9a-fA-F:]+\]:\d{1,5}", re.ASCII)
_LONGEST_SILENCE_S = 7.0 * 86_400.0
"""Rules count the evaluations of the centre over that time, which must be much shorter than its retention."""
_MADE = "Made by robot-health export fleet."
"""First words of README.md: what an earlier export has written may be replaced."""
_TLS = {
    "CERTIFICATE": ", `tls.crt` and `tls.key`",
    "TLS_FLAGS": " \\\n  -tls -tlsCertFile=/etc/robot-health-centre/tls.crt"
    " -tlsKeyFile=/etc/robot-health-centre/tls.key",
    "TLS_CONFIG": "printf 'tls_server_config: {cert_file: %s, key_file: %s}\\n' \\\n"
    "  $etc/tls.crt $etc/tls.key >> $etc/web.yml",
}
"""Fields of a centre with https."""


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
    """Returns the URL of a receiver; raises ConfigError if it is not one in full, or contains a password."""
    try:
        if _URL.fullmatch(url) is not None and urlsplit(url).port != 0:
            return url
    except ValueError:
        pass  # a port above 65535
    example = "such as https://centre:9090/api/v1/write"
    raise ConfigError(f"expected the URL of a receiver in full, {example}, without user, password and query")


def require_address(address: str) -> str:
    """Returns `host:port`; raises ConfigError if it is none."""
    if not _ADDRESS.fullmatch(address) or not 0 < int(address.rpartition(":")[2]) < 65536:
        raise ConfigError(f"expected host:port of a monitor, got {address[:100]!r}")
    return address


def export_fleet(
    settings: FleetSettings, config: MonitorConfig, expected: Sequence[str] | None = None
) -> dict[str, str]:
    """Returns the files of both sides by their paths.

    `config` is that of the dashboard; `expected` are the robots that must report, None stands for those that did.
    Raises ConfigError if the settings do not fit together.
    """
    _require_silence(settings, expected is not None)
    interval_s, receiver = settings.interval_s, urlsplit(settings.receiver)
    port = receiver.port or (443 if receiver.scheme == "https" else 80)
    retention_d = math.ceil((settings.outage_s + _CENTRE_MARGIN_S) / 86_400.0)  # never shorter than it takes samples
    bind = "CAP_NET_BIND_SERVICE" if port < 1024 else ""
    fields = {
        "INTERVAL": duration(interval_s),
        "TIMEOUT": duration(min(10.0, interval_s)),
        "TARGETS": ", ".join(f'"{address}"' for address in settings.monitors),
        "MONITORS": "\n".join(f"- {address}" for address in settings.monitors),
        "RECEIVER": settings.receiver,
        "CENTRE": f"{receiver.scheme}://{receiver.netloc}",
        "PORT": str(port),
        "OUTAGE": duration(settings.outage_s),
        "AGENT_KEEPS": duration(settings.outage_s + _AGENT_MARGIN_S),
        "WINDOW": duration(settings.outage_s + _CENTRE_MARGIN_S),
        "RETENTION": f"{max(_RETENTION_DAYS, retention_d)}d",
        "CAPABILITIES": (f"AmbientCapabilities={bind}\n" if bind else "") + f"CapabilityBoundingSet={bind}",
        **(_TLS if receiver.scheme == "https" else dict.fromkeys(_TLS, "")),
    }
    fields["SCRAPES"] = filled("scrapes.yml", fields)
    rules = export_fleet_rules(expected, interval_s=interval_s, silent_after_s=settings.silent_after_s)
    made = {"centre/rules.yaml": rules, "centre/dashboard.json": export_dashboard(config)}
    paths = ["README.md", *(f"{path.parent.name}/{path.name}" for path in sorted(FILES.glob("*/*")))]
    return {**{path: filled(path, fields) for path in paths if path not in made}, **made}


def write_files(folder: str, files: Mapping[str, str]) -> None:
    """Writes files, each at once; raises ConfigError if one cannot be written, or the folder has another README.md."""
    readme = os.path.join(folder, "README.md")
    if not folder or (os.path.lexists(readme) and not _is_exported(readme)):
        problem = "is not from an earlier export; expected another folder" if folder else "expected a folder, got ''"
        raise ConfigError(problem, file=readme if folder else "")
    for name, text in files.items():
        path = os.path.join(folder, name)
        try:
            os.makedirs(os.path.dirname(path), exist_ok=True)
            with open(f"{path}.new", "w", encoding="utf-8") as stream:
                stream.write(text)
            os.replace(f"{path}.new", path)
        except OSError as error:
            raise ConfigError(f"cannot be written: {error.strerror or error}", file=path) from None


def _is_exported(readme: str) -> bool:
    try:
        with open(readme, encoding="utf-8", errors="replace") as stream:
            return stream.read(len(_MADE)) == _MADE
    except OSError:
        return False


def _require_silence(settings: FleetSettings, has_fleet_file: bool) -> None:
    """Raises ConfigError if a silent robot would be an alert after a lost scrape, or never."""
    least_s, most_s = 4.0 * settings.interval_s, _LONGEST_SILENCE_S if has_fleet_file else EXPECTED_S / 2.0
    if not least_s <= settings.silent_after_s <= most_s:
        without = "" if has_fleet_file else ": without a fleet.yaml, it is expected for 24 h after it last reported"
        raise ConfigError(
            f"a robot must be an alert after {duration(least_s)} (4 intervals) to {duration(most_s)} of silence, "
            f"got {duration(settings.silent_after_s)}{without}"
        )
