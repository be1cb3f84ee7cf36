"""Configuration of operations: an `ops.yaml` becomes frozen values.

All sections are optional. Every error names file, line and key. Notification targets, commands above all, come only
from this file, which is read at startup.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from typing import Any, Dict, Iterator, Mapping, Optional, Tuple
from urllib.parse import urlsplit

from ..core.config import YamlFile, read_parameters, require_mapping
from ..core.config.schema import REQUIRED, absolute_path, declared, parameters, read_section
from ..core.values import ConfigError, JsonObject, Level, Problems

SECTIONS = ("history", "black_box", "notify", "server")

TARGET_TYPES = ("alertmanager", "webhook", "command", "apprise", "heartbeat")

MOST_TARGETS = 50  # each has a thread

_LEVELS = ("WARN", "STALE", "ERROR")
_TARGET_NAME = re.compile(r"[\w.-]{1,64}\Z", re.ASCII)
_APPRISE = re.compile(r"[a-z][a-z0-9+.-]*://.", re.ASCII | re.IGNORECASE)
_MOST_SHOWN = 40

Mistakes = Iterator[Tuple[str, str]]
"""Key and problem of values that cannot be used; see `read_section`."""


@dataclass(frozen=True)
class HistorySettings:
    """Where alerts are stored, and for how long."""

    file: str = declared(REQUIRED, "path of the SQLite file, which is created", is_path=True)
    keep_days: float = declared(90.0, "age at which entries are deleted, in days", 0.01, 36_500.0)
    keep_mb: float = declared(500.0, "largest size of the file with its log, in MB; old entries are deleted", 1, 1e6)
    samples: bool = declared(True, "also store samples: per signal and 10 s smallest, largest, mean and last value")


@dataclass(frozen=True)
class BlackBoxSettings:
    """What is recorded around alerts, and for how long it is kept."""

    folder: str = declared(REQUIRED, "path of the folder with the recordings, which is created", is_path=True)
    topics: Tuple[str, ...] = declared(
        (), "further topics to record, absolute names; * and ? as in file names, except for images and clouds"
    )
    before_s: float = declared(30.0, "time before an alert that is recorded, in s", 0.0, 3600.0)
    after_s: float = declared(10.0, "time after the latest alert that is recorded, in s", 0.0, 3600.0)
    min_level: Level = declared(Level.WARN, "lowest level that is recorded", choices=_LEVELS)
    memory_mb: float = declared(32.0, "memory of the messages of all robots, in MB; the oldest go first", 1, 1e5)
    keep_mb: float = declared(1000.0, "largest size of the folder, in MB; the oldest recordings are deleted", 1, 1e7)
    keep_days: float = declared(30.0, "age at which recordings are deleted, in days", 0.01, 36_500.0)

    def mistakes(self, given: JsonObject) -> Mistakes:
        """Yields the mistakes of several keys together."""
        for topic in self.topics:
            if not topic.startswith(("/", "*", "?")) or any(letter.isspace() for letter in topic):
                yield (
                    "topics",
                    f"expected absolute names of topics, such as /imu or /arm/*, got {topic[:_MOST_SHOWN]!r}",
                )


@dataclass(frozen=True)
class TargetSettings:
    """A target of notifications. Those keys that its type does not have keep their defaults."""

    name: str
    type: str = declared(REQUIRED, "kind of target", choices=TARGET_TYPES)
    min_level: Level = declared(Level.WARN, "lowest level that is sent", choices=_LEVELS)
    url: str = declared("", "address; put an address with a secret in url_file", is_secret=True)
    url_file: str = declared("", "path of a file that contains the address", is_path=True)
    command: Tuple[str, ...] = declared(
        (), "program and arguments; a program with a / is relative to this file's folder"
    )
    robots: Tuple[str, ...] = declared(
        (), "names of the robots whose alerts are sent; * and ? as in file names; empty: all", 1
    )
    signals: Tuple[str, ...] = declared(
        (), "names of the signals whose alerts are sent; * and ? as in file names; empty: all", 1
    )
    simulated: bool = declared(False, "send the alerts of simulated values too")
    timeout_s: float = declared(10.0, "longest time for one attempt, in s", 0.1, 300.0)
    group_wait_s: float = declared(0.0, "wait for further events of a robot: all are one message, in s", 0.0, 300.0)
    after_s: float = declared(0.0, "send only alerts that were open for so long, in s", 0.0, 86_400.0)
    every_s: float = declared(60.0, "period of the heartbeat, in s", 1.0, 86_400.0)

    def mistakes(self, given: JsonObject) -> Mistakes:
        """Yields keys that this type does not have, and values that it cannot use."""
        if self.type is None:  # it is not one
            return
        left_out = _LEFT_OUT.get(self.type, ("command", "every_s"))
        keys = [each.name for each in parameters(TargetSettings) if each.name not in left_out]
        for name in [name for name in left_out if name in given]:
            yield name, f"not a key of a target of type {self.type}; expected one of {', '.join(keys)}"
        is_file = bool(given.get("url_file"))
        problem = url_problem(self.url, self.type) if self.url else ""
        if "url" not in keys:
            if not "".join(self.command[:1]).strip():
                yield "command", "expected a program and its arguments, got nothing"
        elif is_file is bool(given.get("url")):
            yield "", f"expected either url or url_file, got {'both' if is_file else 'neither'}"
        elif problem:
            yield "url", problem


_LEFT_OUT: Mapping[str, Tuple[str, ...]] = {
    "alertmanager": ("command", "every_s", "group_wait_s"),
    "command": ("url", "url_file", "every_s"),
    "heartbeat": ("command", "min_level", "robots", "signals", "simulated", "group_wait_s", "after_s"),
}
"""The keys that a type of target does not have; types that are not here have neither `command` nor `every_s`."""


@dataclass(frozen=True)
class ServerOptions:
    """What the section `server` sets. What is None or empty is as configured elsewhere."""

    port: Optional[int] = declared(None, "port, 0 for a free one (left out: as configured elsewhere)", 0, 65535)
    address: str = declared("", "address; others than 127.0.0.1 require a token (empty: as configured elsewhere)")
    token_file: str = declared("", "path of a file with the token that clients must present; empty: none", is_path=True)
    tls_certificate: str = declared(
        "", "path of the certificate (PEM), for wss:// and https://; empty: no TLS", is_path=True
    )
    tls_key: str = declared("", "path of the certificate's private key (PEM)", is_path=True)
    allow_publish: Tuple[str, ...] = declared((), "topics that clients may publish on; * and ? as in file names", 1)
    allow_call: Tuple[str, ...] = declared((), "services that clients may call; * and ? as in file names", 1)
    allow_offer: Tuple[str, ...] = declared((), "services that clients may offer; * and ? as in file names", 1)
    public_url: str = declared("", "address where people reach the page, for links in notifications; empty: no links")

    def mistakes(self, given: JsonObject) -> Mistakes:
        """Yields the mistakes of several keys together."""
        if bool(self.tls_certificate) is not bool(self.tls_key):
            yield "", "expected tls_certificate and tls_key, got one of them"
        if self.public_url and not is_http(self.public_url):
            yield "public_url", f"expected http://host or https://host, got {shown(self.public_url)}"
        if any(letter.isspace() or letter == "/" for letter in self.address):
            yield "address", f"expected an IP address or the name of a host, got {self.address[:_MOST_SHOWN]!r}"


@dataclass(frozen=True)
class OpsConfig:
    """The contents of an `ops.yaml`."""

    history: Optional[HistorySettings] = None
    notify: Tuple[TargetSettings, ...] = ()  # in the order of the file
    server: Optional[ServerOptions] = None  # None if it is configured elsewhere
    black_box: Optional[BlackBoxSettings] = None

    @property
    def summary(self) -> str:
        """Names of the sections that are configured; empty if none are."""
        return ", ".join(name for name in SECTIONS if getattr(self, name))


def read_ops(file: YamlFile) -> OpsConfig:
    """Reads an `ops.yaml`. Relative paths in it are relative to its folder.

    Raises ConfigError, which names file, line, key, what was expected and what was given; `others` has further ones.
    """
    tree, folder = file.tree, os.path.dirname(os.path.abspath(file.file))
    problems = Problems()
    read_parameters(tree, (), (), SECTIONS, problems)
    sections: Dict[str, Any] = {}
    schemas = {"history": HistorySettings, "black_box": BlackBoxSettings, "server": ServerOptions}
    for name in SECTIONS:
        if name in tree:
            with problems:
                sections[name] = (
                    _read_targets(tree[name], folder)
                    if name == "notify"
                    else read_section(schemas[name], tree[name], (name,), folder)
                )
    with file.located():
        problems.raise_if_any()
    return OpsConfig(**sections)


def _read_targets(value: object, folder: str) -> Tuple[TargetSettings, ...]:
    path = ("notify",)
    tree = require_mapping(value, path)
    if len(tree) > MOST_TARGETS:
        raise ConfigError(f"expected at most {MOST_TARGETS} targets, got {len(tree)}", path)
    problems = Problems()
    targets = []
    for name, target in tree.items():
        if not _TARGET_NAME.match(name):
            problems.add(ConfigError("expected a name of at most 64 letters, digits, _, . and -", (*path, name)))
        with problems:
            read = read_section(TargetSettings, target, (*path, name), folder, name=name)
            if "/" in "".join(read.command[:1]):
                read = replace(read, command=(absolute_path(read.command[0], folder), *read.command[1:]))
            targets.append(read)
    problems.raise_if_any()
    return tuple(targets)


def url_problem(url: str, kind: str) -> str:
    """Returns why an address cannot be one of a type of target; empty if it can. It shows scheme and host only."""
    expected, odd = "http://host:port or https://host:port, without user, password and blanks", " "
    if kind == "apprise":
        expected, is_right = "an address of Apprise, such as mailtos://user:password@host", bool(_APPRISE.match(url))
    else:
        is_right = is_http(url) and "@" not in urlsplit(url).netloc
    if kind == "alertmanager":
        expected, odd = f"{expected}, ? and #", " ?#"
    is_right = is_right and url.isprintable() and not set(odd) & set(url)
    return "" if is_right else f"expected {expected}, got {shown(url)}"


def is_http(url: str) -> bool:
    """Whether a text is an address of HTTP."""
    try:
        parts = urlsplit(url)
        return parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        return False


def shown(url: str) -> str:
    """Returns scheme, host and port of an address: the rest may be a secret.

    >>> shown("https://user:password@chat.example:8443/hooks/secret?key=secret")
    'https://chat.example:8443'
    """
    scheme, separator, rest = url.partition("://")
    if not separator:
        return "an address without a scheme"
    if scheme.lower() not in ("http", "https"):
        return f"{scheme[:20]}://..."  # apprise puts secrets in place of the host
    host = re.split(r"[/?#\\]", rest, maxsplit=1)[0]
    if "@" in rest[len(host) :]:  # a password that contains one of these characters
        return f"{scheme}://..."
    return f"{scheme}://{host.rpartition('@')[2][:200]}"
