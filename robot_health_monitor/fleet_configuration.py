"""fleet.yaml and the addresses on the command line become the settings of each robot.

    defaults: {thresholds: thresholds.yaml, token_file: /etc/robot-health/token}
    robots:
      husky1: {url: ws://10.0.0.7:9090}
      carter: {url: wss://10.0.0.8:9090, namespace: carter, thresholds: carter.yaml, ca: /etc/ssl/fleet.pem}

A robot's key comes before the same key of `defaults`, which comes before the option of the command line. Paths are
relative to the file that contains them.
"""

from __future__ import annotations

import os
import re
import ssl
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from robot_health_monitor.core.errors import ConfigError, Path, Problems
from robot_health_monitor.core.local import LocalBus
from robot_health_monitor.core.middleware import is_namespace
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.parameters import Parameter, describe, read_parameters, require_mapping, unknown_key
from robot_health_monitor.core.yaml_file import YamlFile, read_yaml
from robot_health_monitor.rosbridge.address import full_address, host_and_port, shown_address
from robot_health_monitor.runtime.tokens import TokenFiles

from .embedded import sections_of_nodes

_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_NAMED = re.compile(r"(?P<name>[\w.-]+)=(?P<url>.+)", re.ASCII)
_SHOWN_CHARS = 100
_LARGEST_CA_BYTES = 4_000_000

_DEFAULTS = (
    Parameter("thresholds", str, None, "path of a thresholds.yaml"),
    Parameter("namespace", str, None, "namespace of the robot's topics"),
    Parameter("token_file", str, None, "path of a file with the token to present"),
    Parameter("ca", str, None, "path of the certificate authorities to trust, for wss://"),
)
ROBOT_PARAMETERS = (Parameter("url", str, None, "ws://host:port or wss://host:port"), *_DEFAULTS)


@dataclass(frozen=True)
class Options:
    """Options of the command line for every robot, unless fleet.yaml sets them; as in fleet.yaml."""

    thresholds: str = ""
    """Empty: the defaults of alert_system."""
    namespace: str = ""
    token_file: str = ""
    """Empty: the environment variable."""
    ca: str = ""
    """Empty: those of the system."""


@dataclass(frozen=True)
class RobotEntry:
    """One robot as fleet.yaml or the command line names it. Paths are complete; None: not given."""

    name: str
    """The robot's name, which is also its `hardware_id`."""
    url: str
    """`ws://host:port` or `wss://host:port`; empty: it pushes."""
    thresholds: Optional[str] = None
    namespace: Optional[str] = None
    token_file: Optional[str] = None
    ca: Optional[str] = None


@dataclass(frozen=True)
class RobotSettings:
    """What is needed to watch one robot. Two that are equal need no change."""

    name: str
    url: str
    namespace: str = ""
    token: str = field(default="", repr=False)
    """Presented to the server; empty: none."""
    ca: bytes = field(default=b"", repr=False)
    """The certificate authorities to trust, as PEM; empty: those of the system."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """The configuration of alert_system, nested as in the file."""
    ssl_context: Optional[ssl.SSLContext] = field(default=None, compare=False, repr=False)
    """Trusts `ca`; None: for the system's."""

    @property
    def use_sim_time(self) -> bool:
        """Whether the robot's time is that of its topic /clock."""
        return self.parameters.get("use_sim_time") is True


def is_fleet_file(tree: Mapping[str, Any]) -> bool:
    """Returns whether the contents of a file are those of a fleet.yaml."""
    return "robots" in tree and "alert_system" not in tree


def read_addresses(texts: Sequence[str]) -> List[RobotEntry]:
    """Reads addresses as the command line takes them: `husky:9090`, `ws://husky:9090`, `NAME=wss://10.0.0.7:9090`.

    Without a name, a robot gets the name of its host, with the port if that name is taken. ConfigError: one is not the
    address of a rosbridge server, or two robots have the same name.
    """
    entries: Dict[str, RobotEntry] = {}
    for text in texts:
        named = _NAMED.fullmatch(text)
        name, url = (named["name"], full_address(named["url"])) if named else ("", full_address(text))
        try:
            host, port = host_and_port(url)
        except ConfigError:
            expected = "expected host:port, ws://host:port, wss://host:port or NAME=host:port"
            raise ConfigError(f"{expected}, got {shown_address(text)[:_SHOWN_CHARS]!r}") from None
        if not name:
            name = f"{host}:{port}" if host in entries and port else host
        if name in entries:
            raise ConfigError(f"two robots are named {name}; give them names: one=host:port two=host:port")
        entries[name] = RobotEntry(name, url)
    return list(entries.values())


def read_entries(file: YamlFile, collected: Optional[Problems] = None, *, needs_url: bool = True) -> List[RobotEntry]:
    """Reads a fleet.yaml, not the files that it names. ConfigError: every mistake, with file, line and key.

    With `collected`, which receives the mistakes, the robots without any are returned. Robots that push need no `url`.
    """
    problems = Problems() if collected is None else collected
    entries: List[RobotEntry] = []
    defaults: Dict[str, Any] = {}
    try:
        for key in file.tree:
            if key not in ("defaults", "robots"):
                problems.add(unknown_key(key, ("defaults", "robots")))
        with problems:
            section = require_mapping(file.tree.get("defaults") or {}, ("defaults",))
            defaults = _read_keys(section, _DEFAULTS, ("defaults",))
        with problems:
            robots = require_mapping(file.tree.get("robots"), ("robots",))
            if not robots:
                raise ConfigError("expected at least one robot, got none", ("robots",))
            for name, found in robots.items():
                with problems:
                    entries.append(_read_entry(name, found, defaults, os.path.dirname(file.file), needs_url))
        if collected is None:
            problems.raise_if_any()
    except ConfigError as error:
        raise file.locate(error) from None
    return entries


def _read_entry(name: str, found: object, defaults: Mapping[str, Any], folder: str, needs_url: bool) -> RobotEntry:
    path = ("robots", name)
    if not _NAME.fullmatch(name):
        expected = "expected a name of at most 64 letters, digits and _ . -"
        raise ConfigError(f"{expected}, got {describe(name)}", path)
    values = _read_keys(require_mapping(found, path), ROBOT_PARAMETERS, path)
    if values["url"] is None and not needs_url:
        values["url"] = ""
    if values["url"] is None:
        raise ConfigError("expected the address of its rosbridge server, url: ws://host:port", path)
    values.update({key: default for key, default in defaults.items() if values[key] is None})
    for key in ("thresholds", "token_file", "ca"):
        if values[key]:
            values[key] = os.path.join(folder, os.path.expanduser(values[key]))
    return RobotEntry(name, **values)


def _read_keys(found: Mapping[str, Any], keys: Sequence[Parameter], path: Path) -> Dict[str, Any]:
    problems = Problems()
    values: Dict[str, Any] = dict.fromkeys(key.name for key in keys)
    with problems:
        values = read_parameters(found, keys, path)
    if values.get("url") is not None:
        try:
            values["url"] = full_address(values["url"])
            host_and_port(values["url"])
        except ConfigError as error:
            problems.add(ConfigError(error.problem, (*path, "url")))
    if not is_namespace(values["namespace"] or ""):
        problem = f"expected a namespace such as carter or fleet/carter, got {describe(values['namespace'])}"
        problems.add(ConfigError(problem, (*path, "namespace")))
    problems.raise_if_any()
    return values


class FleetReader:
    """Reads the settings of all robots: at the start, and again at every reload."""

    def __init__(
        self, addresses: Sequence[RobotEntry], file: str, options: Options, warn: Callable[[str], object]
    ) -> None:
        """Reads nothing yet. `addresses` come before the robots of a fleet.yaml, `file`; empty: none.

        `warn` is called with one line if other users may read a token; from the thread that reads.
        """
        self._addresses = addresses
        self._file = file
        self._options = options
        self._token_files = TokenFiles(warn)

    def read(self) -> List[RobotSettings]:
        """Reads and validates fleet.yaml and every file that it names, each once; ConfigError names file and line."""
        parameters_in = lru_cache(maxsize=None)(_read_thresholds)
        token_in = lru_cache(maxsize=None)(self._token_files.find)
        trust_in = lru_cache(maxsize=None)(_read_trust)

        def settings_of(entry: RobotEntry) -> RobotSettings:
            keys = {**vars(self._options), **{key: value for key, value in vars(entry).items() if value is not None}}
            ca, ssl_context = trust_in(keys["ca"])
            token, parameters = token_in(keys["token_file"]), parameters_in(keys["thresholds"])
            return RobotSettings(entry.name, entry.url, keys["namespace"], token, ca, parameters, ssl_context)

        settings = [settings_of(entry) for entry in self._addresses]
        taken = {robot.name for robot in settings}
        if self._file:
            file = read_yaml(self._file)
            for entry in read_entries(file):
                if entry.name in taken:
                    problem = "a robot of this name is on the command line"
                    raise file.locate(ConfigError(problem, ("robots", entry.name)))
                settings.append(settings_of(entry))
        return settings


def _read_trust(file: str) -> Tuple[bytes, Optional[ssl.SSLContext]]:
    """Returns certificate authorities as PEM, and the TLS settings that trust them; without a file, the system's."""
    if not file:
        return b"", None
    try:
        with open(file, "rb") as stream:
            pem = stream.read(_LARGEST_CA_BYTES)
        return pem, ssl.create_default_context(cafile=file)
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(f"cannot be read as certificates: {error.strerror or error}", file=file) from None


def _read_thresholds(file: str) -> Mapping[str, Any]:
    """Returns the configuration of alert_system in a file. An alert_system without a robot has accepted it."""
    if not file:
        return {}
    contents = read_yaml(file)
    section = sections_of_nodes(contents)["alert_system"]
    try:
        AlertSystem(LocalBus().node("alert_system", parameters=section.tree)).close()
    except ConfigError as error:
        raise contents.locate(error.below(section.path)) from None
    return section.tree
