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
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Dict, Iterator, List, Optional, Sequence, Tuple

from ..core.config import YamlFile, declared, read_parameters, read_section, read_yaml, require_mapping
from ..core.nodes import AlertSystem
from ..core.port import LocalBus
from ..core.values import ConfigError, JsonObject, Problems, describe, is_namespace
from ..runtime.bridge.address import full_address, host_and_port, shown_address
from ..runtime.tokens import TokenFiles
from .embedded import sections_of_nodes

_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_NAMED = re.compile(r"(?P<name>[\w.-]+)=(?P<url>.+)", re.ASCII)
_SHOWN_CHARS = 100
_LARGEST_CA_BYTES = 4_000_000


@dataclass(frozen=True)
class Options:
    """Settings of a robot that may be common to several: `defaults` of fleet.yaml, options of the command line.

    A field is None if it was not given. Empty fields mean the defaults of alert_system, no namespace, the environment
    variable with a token, and the certificate authorities of the system.
    """

    thresholds: Optional[str] = declared(None, "path of a thresholds.yaml", is_path=True)
    namespace: Optional[str] = declared(None, "namespace of the robot's topics")
    token_file: Optional[str] = declared(None, "path of a file with the token to present", is_path=True)
    ca: Optional[str] = declared(None, "path of the certificate authorities to trust, for TLS", is_path=True)

    def mistakes(self, given: JsonObject) -> Iterator[Tuple[str, str]]:
        """Yields key and problem of values that cannot be used; see `read_section`."""
        if not is_namespace(self.namespace or ""):
            yield "namespace", f"expected a namespace such as carter or fleet/carter, got {describe(self.namespace)}"


@dataclass(frozen=True)
class RobotEntry(Options):
    """One robot as fleet.yaml or the command line names it: its name, and its address, empty if it pushes."""

    name: str = ""
    url: str = declared("", "ws://host:port, wss://host:port, foxglove://host:port or foxglove+tls://host:port")

    def mistakes(self, given: JsonObject) -> Iterator[Tuple[str, str]]:
        """Yields key and problem of values that cannot be used; see `read_section`."""
        yield from super().mistakes(given)
        try:
            host_and_port(full_address(self.url or "ws://none"))
        except ConfigError as error:
            yield "url", error.problem

    def completed(self, options: Options) -> RobotEntry:
        """Returns it with the options that it does not have."""
        return replace(self, **{name: value for name, value in vars(options).items() if getattr(self, name) is None})


@dataclass(frozen=True)
class RobotSettings:
    """What is needed to watch one robot. Two that are equal need no change."""

    name: str
    url: str
    namespace: str = ""
    token: str = field(default="", repr=False)
    """Presented to the server; empty if it requires none."""
    ca: bytes = field(default=b"", repr=False)
    """The certificate authorities to trust, as PEM; empty to trust those of the system."""
    parameters: JsonObject = field(default_factory=dict)
    """The configuration of alert_system, nested as in the file."""
    ssl_context: Optional[ssl.SSLContext] = field(default=None, compare=False, repr=False)
    """Trusts `ca`; None to trust the system's authorities."""

    @property
    def use_sim_time(self) -> bool:
        """Whether the robot's time is that of its topic /clock."""
        return self.parameters.get("use_sim_time") is True


def is_fleet_file(tree: JsonObject) -> bool:
    """Returns whether the contents of a file are those of a fleet.yaml."""
    return "robots" in tree and "alert_system" not in tree


def read_addresses(texts: Sequence[str]) -> List[RobotEntry]:
    """Reads addresses as the command line takes them: `husky:9090`, `ws://husky:9090`, `NAME=wss://10.0.0.7:9090`.

    Without a name, a robot gets the name of its host, with the port if that name is taken. Raises ConfigError if one
    is not the address of a bridge, or two robots have the same name.
    """
    entries: Dict[str, RobotEntry] = {}
    for text in texts:
        named = _NAMED.fullmatch(text)
        name, url = (named["name"], full_address(named["url"])) if named else ("", full_address(text))
        try:
            host, port = host_and_port(url)
        except ConfigError:
            expected = "expected host:port, ws://host:port, wss://host:port, foxglove://host:port or NAME=ADDRESS"
            raise ConfigError(f"{expected}, got {shown_address(text)[:_SHOWN_CHARS]!r}") from None
        if not name:
            name = f"{host}:{port}" if host in entries and port else host
        if name in entries:
            raise ConfigError(f"two robots are named {name}; give them names: one=host:port two=host:port")
        entries[name] = RobotEntry(name=name, url=url)
    return list(entries.values())


def read_entries(file: YamlFile, collected: Optional[Problems] = None, *, needs_url: bool = True) -> List[RobotEntry]:
    """Reads a fleet.yaml, not the files that it names. Raises ConfigError with every mistake, with file, line and key.

    With `collected`, which receives the mistakes, the robots without any are returned. Robots that push need no `url`.
    """
    problems = Problems() if collected is None else collected
    folder = os.path.dirname(file.file)
    entries: List[RobotEntry] = []
    defaults = Options()
    with file.located():
        read_parameters(file.tree, (), (), ("defaults", "robots"), problems)
        with problems:
            defaults = read_section(Options, file.tree.get("defaults") or {}, ("defaults",), folder)
        with problems:
            robots = require_mapping(file.tree.get("robots"), ("robots",))
            if not robots:
                raise ConfigError("expected at least one robot, got none", ("robots",))
            for name, given in robots.items():
                with problems:
                    entry = _read_entry(name, given, folder, needs_url=needs_url)
                    entries.append(entry.completed(defaults))
        if collected is None:
            problems.raise_if_any()
    return entries


def _read_entry(name: str, given: object, folder: str, *, needs_url: bool) -> RobotEntry:
    path = ("robots", name)
    if not _NAME.fullmatch(name):
        expected = "expected a name of at most 64 letters, digits and _ . -"
        raise ConfigError(f"{expected}, got {describe(name)}", path)
    entry = read_section(RobotEntry, given, path, folder, name=name)
    if not entry.url and needs_url:
        raise ConfigError("expected the address of its bridge, url: ws://host:port or foxglove://host:port", path)
    return replace(entry, url=full_address(entry.url)) if entry.url else entry


def read_robots(
    addresses: Sequence[RobotEntry], file: str, options: Options, token_files: TokenFiles
) -> List[RobotSettings]:
    """Reads and validates a fleet.yaml and every file that it names, each once; ConfigError names file and line.

    `addresses` come before the robots of `file`, which may be empty.
    """
    entries = list(addresses)
    if file:
        fleet, taken = read_yaml(file), {entry.name for entry in entries}
        for entry in read_entries(fleet):
            if entry.name in taken:
                with fleet.located(("robots", entry.name)):
                    raise ConfigError("a robot of this name is on the command line")
            entries.append(entry)
    parameters_in = lru_cache(maxsize=None)(_read_thresholds)
    token_in = lru_cache(maxsize=None)(token_files.find)
    trust_in = lru_cache(maxsize=None)(_read_trust)
    settings = []
    for robot in (entry.completed(options) for entry in entries):
        ca, ssl_context = trust_in(robot.ca or "")
        token, parameters = token_in(robot.token_file or ""), parameters_in(robot.thresholds or "")
        given = (robot.name, robot.url, robot.namespace or "")
        settings.append(RobotSettings(*given, token, ca, parameters, ssl_context))
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


def _read_thresholds(file: str) -> JsonObject:
    """Returns the configuration of alert_system in a file. An alert_system without a robot has accepted it."""
    if not file:
        return {}
    contents = read_yaml(file)
    section = sections_of_nodes(contents)["alert_system"]
    with contents.located(section.path):
        AlertSystem(LocalBus().node("alert_system", parameters=section.tree)).close()
    return section.tree
