"""Configuration of operations: an `ops.yaml` becomes frozen values.

Three optional sections: `history`, `notify` and `server`. Every error names file, line and key. Notification targets,
commands above all, come only from this file, which is read at startup.
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, field
from typing import Any, Dict, Mapping, Optional, Sequence, Tuple
from urllib.parse import urlsplit

from robot_health_monitor.core.errors import ConfigError, Path, Problems
from robot_health_monitor.core.formatting import bound_text
from robot_health_monitor.core.model import Level
from robot_health_monitor.core.parameters import Parameter, read_parameters, require_mapping, with_present_names
from robot_health_monitor.core.yaml_file import YamlFile

SECTIONS = ("history", "black_box", "notify", "server")

TARGET_TYPES = ("alertmanager", "webhook", "command", "apprise", "heartbeat")

MOST_TARGETS = 50  # each has a thread

HISTORY_PARAMETERS = (
    Parameter("file", str, None, "path of the SQLite file, which is created"),
    Parameter("keep_days", float, 90.0, "age at which entries are deleted, in days", 0.01, 36_500.0),
    Parameter("keep_mb", float, 500.0, "largest size of the file with its log, in MB; old entries are deleted", 1, 1e6),
    Parameter("samples", bool, True, "also store samples: per signal and 10 s smallest, largest, mean and last value"),
)

BLACK_BOX_PARAMETERS = (
    Parameter("folder", str, None, "path of the folder with the recordings, which is created"),
    Parameter(
        "topics", tuple, (),
        "further topics to record, absolute names; * and ? as in file names, except for images and clouds",
    ),
    Parameter("before_s", float, 30.0, "time before an alert that is recorded, in s", 0.0, 3600.0),
    Parameter("after_s", float, 10.0, "time after the latest alert that is recorded, in s", 0.0, 3600.0),
    Parameter("min_level", str, "WARN", "lowest level that is recorded", choices=("WARN", "STALE", "ERROR")),
    Parameter("memory_mb", float, 32.0, "memory of the messages of all robots, in MB; the oldest go first", 1, 1e5),
    Parameter("keep_mb", float, 1000.0, "largest size of the folder, in MB; the oldest recordings are deleted", 1, 1e7),
    Parameter("keep_days", float, 30.0, "age at which recordings are deleted, in days", 0.01, 36_500.0),
)  # fmt: skip

_TYPE = Parameter("type", str, None, "kind of target", choices=TARGET_TYPES)

TARGET_PARAMETERS = (
    _TYPE,
    Parameter("url", str, "", "address; put an address with a secret in url_file"),
    Parameter("url_file", str, "", "path of a file that contains the address"),
    Parameter("command", tuple, (), "program and arguments; a program with a / is relative to this file's folder"),
    Parameter("min_level", str, "WARN", "lowest level that is sent", choices=("WARN", "STALE", "ERROR")),
    Parameter("robots", tuple, (), "names of the robots whose alerts are sent; * and ? as in file names; empty: all"),
    Parameter("signals", tuple, (), "names of the signals whose alerts are sent; * and ? as in file names; empty: all"),
    Parameter("simulated", bool, False, "send the alerts of simulated values too"),
    Parameter("timeout_s", float, 10.0, "longest time for one attempt, in s", 0.1, 300.0),
    Parameter("every_s", float, 60.0, "period of the heartbeat, in s", 1.0, 86_400.0),
)  # fmt: skip

_ADDRESS = ("type", "url", "url_file")
_FILTER = ("min_level", "robots", "signals", "simulated", "timeout_s")
_KEYS: Mapping[str, Sequence[str]] = {
    **dict.fromkeys(("alertmanager", "webhook", "apprise"), (*_ADDRESS, *_FILTER)),
    "command": ("type", "command", *_FILTER),
    "heartbeat": (*_ADDRESS, "every_s", "timeout_s"),
}
"""The keys of each type of target."""

SERVER_PARAMETERS = (
    Parameter("port", int, None, "port, 0 for a free one (left out: as configured elsewhere)", 0, 65535),
    Parameter("address", str, "", "address; others than 127.0.0.1 require a token (empty: as configured elsewhere)"),
    Parameter("token_file", str, "", "path of a file with the token that clients must present; empty: none"),
    Parameter("tls_certificate", str, "", "path of the certificate (PEM), for wss:// and https://; empty: no TLS"),
    Parameter("tls_key", str, "", "path of the certificate's private key (PEM)"),
    Parameter("allow_publish", tuple, (), "topics that clients may publish on; * and ? as in file names"),
    Parameter("allow_call", tuple, (), "services that clients may call; * and ? as in file names"),
    Parameter("allow_offer", tuple, (), "services that clients may offer; * and ? as in file names"),
)  # fmt: skip

_TARGET_NAME = re.compile(r"[\w.-]{1,64}\Z", re.ASCII)
_SCHEME = re.compile(r"[a-z][a-z0-9+.-]*\Z", re.ASCII)
_MOST_SHOWN = 40


@dataclass(frozen=True)
class HistorySettings:
    """Where alerts are stored, and for how long: `HISTORY_PARAMETERS`. The path is absolute."""

    file: str
    keep_days: float = 90.0
    keep_mb: float = 500.0
    samples: bool = True


@dataclass(frozen=True)
class BlackBoxSettings:
    """What is recorded around alerts, and for how long it is kept: `BLACK_BOX_PARAMETERS`. The path is absolute."""

    folder: str
    topics: Tuple[str, ...] = ()
    before_s: float = 30.0
    after_s: float = 10.0
    min_level: Level = Level.WARN  # by severity
    memory_mb: float = 32.0
    keep_mb: float = 1000.0
    keep_days: float = 30.0


@dataclass(frozen=True)
class TargetSettings:
    """A target of notifications: `TARGET_PARAMETERS`; those that its type does not have keep their defaults."""

    name: str
    type: str
    min_level: Level = Level.WARN  # by severity
    robots: Tuple[str, ...] = ()
    signals: Tuple[str, ...] = ()
    simulated: bool = False
    url: str = field(default="", repr=False)  # it may contain a secret
    url_file: str = ""  # an absolute path; empty: the address is in `url`
    command: Tuple[str, ...] = ()
    timeout_s: float = 10.0
    every_s: float = 60.0


@dataclass(frozen=True)
class ServerOptions:
    """What the section `server` sets: `SERVER_PARAMETERS`. None, or empty: as configured elsewhere. Absolute paths."""

    port: Optional[int] = None
    address: str = ""
    token_file: str = ""
    tls_certificate: str = ""
    tls_key: str = ""
    allow_publish: Tuple[str, ...] = ()
    allow_call: Tuple[str, ...] = ()
    allow_offer: Tuple[str, ...] = ()


@dataclass(frozen=True)
class OpsConfig:
    """The contents of an `ops.yaml`."""

    history: Optional[HistorySettings] = None
    notify: Tuple[TargetSettings, ...] = ()  # in the order of the file
    server: Optional[ServerOptions] = None  # None: as configured elsewhere
    black_box: Optional[BlackBoxSettings] = None

    @property
    def summary(self) -> str:
        """What is configured, in one line; empty: nothing."""
        parts = [] if self.history is None else [f"history in {self.history.file}"]
        if self.black_box is not None:
            parts.append(f"black box in {self.black_box.folder}")
        if self.notify:
            names = ", ".join(target.name for target in self.notify)
            parts.append(f"{len(self.notify)} target{'s' if len(self.notify) > 1 else ''} ({names})")
        return "; ".join(parts + ([] if self.server is None else ["server"]))


def read_ops(file: YamlFile) -> OpsConfig:
    """Reads an `ops.yaml`. Relative paths in it are relative to its folder.

    Raises ConfigError, which names file, line, key, what was expected and what was found; `others`: further mistakes.
    """
    tree, folder = file.tree, os.path.dirname(os.path.abspath(file.file))
    problems = Problems()
    sections: Dict[str, Any] = {}
    try:
        with problems:
            read_parameters(tree, (), (), SECTIONS)
        for name, read in zip(SECTIONS, (_read_history, _read_black_box, _read_targets, _read_server)):
            if name in tree:
                with problems:
                    sections[name] = read(require_mapping(tree[name], (name,)), (name,), folder)
        problems.raise_if_any()
    except ConfigError as error:
        raise file.locate(error) from None
    return OpsConfig(**sections)


def check_url(url: str, kind: str, path: Path = ()) -> None:
    """Raises ConfigError, with no more of an address than scheme and host, if it cannot be one of a type of target."""
    expected = _expected_url(url, kind)
    if expected:
        raise ConfigError(f"expected {expected}, got {_shown_url(url)}", path)


def is_http(url: str) -> bool:
    """Whether a text is an address of HTTP."""
    try:
        parts = urlsplit(url)
        return parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        return False


def _expected_url(url: str, kind: str) -> str:
    """Returns what the address of a type of target should be; empty: as it is."""
    if any(letter.isspace() or not letter.isprintable() for letter in url):
        return "an address without blanks"
    if kind == "apprise":
        scheme, _, rest = url.partition("://")
        is_address = rest and _SCHEME.match(scheme.lower())
        return "" if is_address else "an address of Apprise, such as mailtos://user:password@host"
    if not is_http(url):
        return "http://host:port or https://host:port"
    parts = urlsplit(url)
    if "@" in parts.netloc:
        return "an address without user and password"
    if kind == "alertmanager" and (parts.query or parts.fragment):
        return "an address without ? and #"
    return ""


def _shown_url(url: str) -> str:
    """Returns scheme and host: the rest of an address may be a secret, and so may the host in those of Apprise."""
    scheme, separator, rest = url.partition("://")
    if not separator:
        return "an address without a scheme" if url else "''"
    if rest and scheme.lower() not in ("http", "https"):
        return repr(f"{scheme}://..."[:_MOST_SHOWN])
    host = re.split(r"[/?#]", rest.rpartition("@")[2] if "@" in rest else rest)[0]
    return repr(f"{scheme}://{host}"[:_MOST_SHOWN])


def _read_history(tree: Mapping[str, Any], path: Path, folder: str) -> HistorySettings:
    problems = Problems()
    values = _read_values(tree, HISTORY_PARAMETERS, path, problems)
    file = str(values.get("file", ""))
    if not tree.get("file", ""):
        problems.add(ConfigError("expected the path of the history file, got nothing", (*path, "file")))
    elif file.endswith("/"):
        problems.add(ConfigError(f"expected the path of a file, got the folder {file!r}", (*path, "file")))
    problems.raise_if_any()
    return HistorySettings(**{**values, "file": _resolve(file, folder)})


def _read_black_box(tree: Mapping[str, Any], path: Path, folder: str) -> BlackBoxSettings:
    problems = Problems()
    values = _read_values(tree, BLACK_BOX_PARAMETERS, path, problems)
    if not tree.get("folder", ""):
        problems.add(ConfigError("expected the path of the folder, got nothing", (*path, "folder")))
    for topic in values.get("topics", ()):
        if not topic.startswith(("/", "*", "?")) or any(letter.isspace() for letter in topic):
            problem = f"expected absolute names of topics, such as /imu or /arm/*, got {topic[:_MOST_SHOWN]!r}"
            problems.add(ConfigError(problem, (*path, "topics")))
    problems.raise_if_any()
    return BlackBoxSettings(
        **{**values, "folder": _resolve(str(values["folder"]), folder), "min_level": Level[values["min_level"]]}
    )


def _read_targets(tree: Mapping[str, Any], path: Path, folder: str) -> Tuple[TargetSettings, ...]:
    if len(tree) > MOST_TARGETS:
        raise ConfigError(f"expected at most {MOST_TARGETS} targets, got {len(tree)}", path)
    problems = Problems()
    targets = []
    for name, target in tree.items():
        with problems:
            if not _TARGET_NAME.match(name):
                problem = "expected a name of at most 64 letters, digits, _, . and -"
                problems.add(ConfigError(problem, (*path, name)))
            targets.append(_read_target(name, target, (*path, name), folder))
    problems.raise_if_any()
    return tuple(targets)


def _read_target(name: str, found: object, path: Path, folder: str) -> TargetSettings:
    tree = require_mapping(found, path)
    problems = Problems()
    kind = ""
    with problems:
        if "type" not in tree:
            raise ConfigError(f"is missing; expected {_TYPE.allowed}", (*path, "type"))
        kind = _TYPE.read(tree["type"], (*path, "type"))
    keys = _KEYS.get(kind, [parameter.name for parameter in TARGET_PARAMETERS])
    left_out = [parameter.name for parameter in TARGET_PARAMETERS if parameter.name not in keys]
    for key in left_out:
        if key in tree:
            problem = f"not a key of a target of type {kind}; expected one of {', '.join(keys)}"
            problems.add(ConfigError(problem, (*path, key)))
    url = tree.get("url", "")
    if not (isinstance(url, str) and url.isprintable()):
        # What was found is not shown: it may contain a secret.
        problems.add(ConfigError("expected printable text, got something else", (*path, "url")))
        left_out.append("url")
    values = _read_values(
        {key: value for key, value in tree.items() if key not in ("type", *left_out)},
        [parameter for parameter in TARGET_PARAMETERS if parameter.name in keys and parameter is not _TYPE],
        path,
        problems,
    )
    if kind:
        with problems:
            _check_address(values, tree, kind, path)
        command = values.get("command", ("unknown",))
        if not (command and command[0].strip()):
            got = "an empty text" if command else "nothing"
            problems.add(ConfigError(f"expected a program and its arguments, got {got}", (*path, "command")))
        _check_patterns(values, ("robots", "signals"), path, problems)
        if values.get("timeout_s", 0.0) > values.get("every_s", math.inf):
            if "timeout_s" in tree:
                most, got = bound_text(values["every_s"]), bound_text(values["timeout_s"])
                problems.add(ConfigError(f"expected at most every_s ({most}), got {got}", (*path, "timeout_s")))
            values["timeout_s"] = values["every_s"]
    problems.raise_if_any()
    if values.get("url_file"):
        values["url_file"] = _resolve(values["url_file"], folder)
    if "command" in values and "/" in values["command"][0]:
        values["command"] = (_resolve(values["command"][0], folder), *values["command"][1:])
    if "min_level" in values:
        values["min_level"] = Level[values["min_level"]]
    return TargetSettings(name, kind, **values)


def _check_address(values: Mapping[str, Any], tree: Mapping[str, Any], kind: str, path: Path) -> None:
    if "url" not in _KEYS[kind]:
        return
    if tree.get("url") and tree.get("url_file"):
        raise ConfigError("expected either url or url_file, got both", (*path, "url_file"))
    if not tree.get("url") and not tree.get("url_file"):
        raise ConfigError("expected either url or url_file, got neither", path)
    if values.get("url"):
        check_url(values["url"], kind, (*path, "url"))


def _read_server(tree: Mapping[str, Any], path: Path, folder: str) -> ServerOptions:
    problems = Problems()
    values = _read_values(tree, SERVER_PARAMETERS, path, problems)
    for one, other in (("tls_certificate", "tls_key"), ("tls_key", "tls_certificate")):
        if tree.get(one) and not tree.get(other):
            problems.add(ConfigError(f"expected {other} as well, got {one} alone", (*path, one)))
    _check_patterns(values, ("allow_publish", "allow_call", "allow_offer"), path, problems)
    address = values.get("address", "")
    if any(letter.isspace() or letter == "/" for letter in address):
        problem = f"expected an IP address or the name of a host, got {address[:_MOST_SHOWN]!r}"
        problems.add(ConfigError(problem, (*path, "address")))
    problems.raise_if_any()
    for key in ("token_file", "tls_certificate", "tls_key"):
        values[key] = _resolve(values[key], folder)
    return ServerOptions(**values)


def _read_values(
    found: Mapping[str, Any], parameters: Sequence[Parameter], path: Path, problems: Problems
) -> Dict[str, Any]:
    """Reads each key on its own, so that a wrong one does not hide the mistakes of others; wrong ones are left out."""
    values = read_parameters({}, parameters)
    with problems:
        found = with_present_names(found, parameters, path)
    for key, value in found.items():
        values.pop(key, None)
        with problems:
            values[key] = read_parameters({key: value}, parameters, path)[key]
    return values


def _check_patterns(values: Mapping[str, Any], keys: Sequence[str], path: Path, problems: Problems) -> None:
    for key in keys:
        if any(not pattern.strip() for pattern in values.get(key, ())):
            problems.add(ConfigError("expected patterns of names, got an empty text", (*path, key)))


def _resolve(file: str, folder: str) -> str:
    """Returns a path of the file as an absolute one; `~` is the home directory."""
    return os.path.normpath(os.path.join(folder, os.path.expanduser(file))) if file else ""
