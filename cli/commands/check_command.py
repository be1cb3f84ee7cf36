"""`robot-health check`: reports every mistake in configuration files, without starting anything."""

from __future__ import annotations

import argparse
import difflib
import importlib
import os
import re
import sys
from typing import Any, Callable, Mapping, Sequence

from ...core.config import (
    NODES,
    MonitorConfig,
    Section,
    YamlFile,
    find_section,
    is_whole_file,
    read_monitor,
    read_yaml,
    remarks_of,
    sections,
)
from ...core.messages import MESSAGES, PACKAGES, standard_messages
from ...core.nodes import Aggregator, BatterySensor
from ...core.port import LocalBus, Middleware
from ...core.values import (
    ConfigError,
    JsonObject,
    Problems,
    count_text,
    list_text,
    printable,
    selection,
    split_type_name,
)
from ...ops.configuration import SECTIONS, OpsConfig, read_ops
from ...runtime.interrupts import Interrupts
from ..arguments import Parser, add
from ..exit_codes import ExitCode
from ..fleet_configuration import is_fleet_file, read_entries

_OTHERS: Mapping[str, Callable[[Middleware], Any]] = {"aggregator": Aggregator, "battery_sensor": BatterySensor}
"""Nodes that check their parameters where they start, on a bus without others."""

_ALIKE = 0.8
"""Similarity (difflib) from which a name counts as misspelt; battery_sensor and temperature_sensor differ."""

_NAMES_SHOWN = 5

_TOPIC = re.compile(r"(~/?|/)?[A-Za-z_]\w*(/\w+)*\Z", re.ASCII)


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = "Checks configuration files as the nodes do, and reports mistakes with file, line and key."
    add(parser, "--verbose", "list all allowed keys beside each unknown one")
    add(parser, "FILE...", "a thresholds.yaml, ops.yaml or fleet.yaml", dest="files")


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Checks the files; returns the exit code."""
    return ExitCode.SUCCESS if check(arguments.files, verbose=arguments.verbose) else ExitCode.USAGE


def check(files: Sequence[str], *, verbose: bool = False) -> bool:
    """Writes valid files and remarks on stdout, mistakes on stderr, one per line; returns whether all are valid.

    Remarks are written about valid files only. With `verbose`, mistakes have their details.
    """
    valid = True
    for file in files:
        summary, remarks, errors = _check_file(file)
        if not errors:
            for line in (f"{file}: OK: {summary}", *map(str, remarks)):
                sys.stdout.write(f"{printable(line)}\n")
            continue
        valid = False
        lines = (f"{error}; {error.details}" if verbose and error.details else str(error) for error in errors)
        for line in dict.fromkeys(lines):
            sys.stderr.write(f"{printable(line)}\n")
        if len(errors) >= Problems.LIMIT:
            sys.stderr.write(f"{printable(file)}: further mistakes are not shown\n")
    return valid


def _check_file(file: str) -> tuple[str, list[ConfigError], list[ConfigError]]:
    """Returns a summary of a file, remarks, and its mistakes, by line."""
    summary = ""
    remarks: list[ConfigError] = []
    errors: list[ConfigError] = []
    duplicates, problems = Problems(), Problems()
    try:
        read = read_yaml(file, duplicates)
        with read.located():
            summary = _check_contents(read, problems, remarks)
            problems.raise_if_any()
    except ConfigError as error:
        errors.extend(error.all)
    return summary, remarks, sorted([*duplicates.errors, *errors], key=lambda error: error.line or 0)


def _check_contents(file: YamlFile, problems: Problems, remarks: list[ConfigError]) -> str:
    """Adds the mistakes of a file to `problems`, and remarks; returns a summary. Raises if there are too many."""
    if _looks_like_ops(file.tree):
        config = OpsConfig()
        with problems:
            config = read_ops(file)
        return config.summary or "no section"
    if is_fleet_file(file.tree):
        return _check_fleet(file, problems, remarks)
    return _check_thresholds(file, problems, remarks)


def _check_thresholds(file: YamlFile, problems: Problems, remarks: list[ConfigError]) -> str:
    by_node: dict[str, list[Section]] = {}
    for section in sections(file.tree, problems):
        close = difflib.get_close_matches(section.node[:60], NODES, n=1, cutoff=_ALIKE)
        name = close[0] if close else section.node
        if section.node != name:
            problems.add(ConfigError(f"unknown node; did you mean {name}?", section.path[:-1]))
        by_node.setdefault(name, []).append(section)
    if "alert_system" not in by_node:
        with problems:
            section = find_section(file.tree, "alert_system", problems)
            by_node["alert_system"] = by_node.pop(section.node)
    config = MonitorConfig({})
    unknown_types: dict[str, None] = {}
    for section in by_node.get("alert_system", ()):
        with problems:
            unknown_types.update(_check_sources(section, problems))
            config = read_monitor(section)
            for name, signal in config.signals.items():
                path = (*section.path, "signals", name)
                errors = (ConfigError(f"remark: {remark}", (*path, key)) for key, remark in remarks_of(signal))
                remarks += map(file.locate, errors)
    for name, start in _OTHERS.items():
        for section in by_node.get(name, ()):
            with problems, file.located(section.path):
                start(LocalBus().node(name, parameters=section.tree)).close()
    unused = sorted(by_node.keys() - {*NODES})
    bounds = sum(len(signal.bounds) for signal in config.signals.values())
    signals = f"{count_text(len(config.signals), 'signal')} ({', '.join(config.signals)})"
    parts = [f"{signals}, {count_text(bounds, 'bound')}"]
    if unknown_types:
        parts.append(f"fields not checked, their types are not known here: {', '.join(unknown_types)}")
    if unused:
        parts.append(f"not used here: {', '.join(unused)}")
    return "; ".join(parts)


def _check_sources(section: Section, problems: Problems) -> dict[str, None]:
    """Collects mistakes in the topics, types and fields of all signals; returns the types that are unknown here."""
    signals = section.tree.get("signals")
    if not isinstance(signals, Mapping):
        return {}
    definitions = known_definitions()
    unknown: dict[str, None] = {}
    for name, signal in signals.items():
        if not isinstance(signal, Mapping):
            continue
        path = (*section.path, "signals", str(name))
        topic, type_name, field = signal.get("topic", str(name)), signal.get("type", ""), signal.get("field", "data")
        where = signal.get("where", "")
        if isinstance(topic, str) and topic not in ("", name) and not _TOPIC.match(topic):
            problems.add(ConfigError(f"expected the name of a topic, got {topic[:60]!a}", (*path, "topic")))
        split = split_type_name(type_name) if isinstance(type_name, str) else None
        if split is None or not isinstance(field, str):
            continue
        spelling = "/".join(split)
        try:
            if not check_field(definitions, str(topic), spelling, field):
                unknown[spelling] = None
            elif isinstance(where, str) and where:
                check_field(definitions, str(topic), spelling, selection("", where) or "", key="where")
        except ConfigError as error:
            problems.add(error.below(path))
    return unknown


def known_definitions() -> list[Any]:
    """Returns the definitions that are available, the best first: those of ROS, then the standard packages.

    Each has `message_class(type_name)` and `field_getter(topic, type_name, field)`, which raise ConfigError if the type
    or the field is unknown.
    """
    try:
        of_ros = importlib.import_module(f"...ros{os.environ.get('ROS_VERSION', '')}.messages", __package__)
        return [of_ros, standard_messages]
    except ImportError:  # none is sourced, or only its environment is there
        return [standard_messages]


def check_field(definitions: Sequence[Any], topic: str, type_name: str, field: str, key: str = "field") -> bool:
    """Checks a field in the first of `definitions` that has the type; returns False if none has. Empty, only the type.

    Raises ConfigError if the type does not exist (its path is `type`), or has no such field (its path is `key`).
    """
    for each in definitions:
        try:
            each.message_class(type_name)
        except ConfigError:
            continue
        try:
            each.field_getter(topic, type_name, field)
        except ConfigError as error:
            raise ConfigError(error.problem, (key,)) from None
        return True
    if type_name.partition("/")[0] not in PACKAGES:
        return False
    close = difflib.get_close_matches(type_name, MESSAGES, n=1)
    hint = f"; did you mean {close[0]}?" if close else ""
    raise ConfigError(f"expected a message type, got {type_name}, which does not exist{hint}", ("type",))


def _looks_like_ops(tree: JsonObject) -> bool:
    """Recognises a section of an ops.yaml at the top, also a misspelt one."""
    return not is_whole_file(tree) and any(
        difflib.get_close_matches(str(key)[:60], SECTIONS, cutoff=_ALIKE) for key in tree
    )


def _check_fleet(file: YamlFile, problems: Problems, remarks: list[ConfigError]) -> str:
    entries = read_entries(file, problems, needs_url=False)
    parts = [count_text(len(entries), "robot")]
    pushing = [entry.name for entry in entries if not entry.url]
    if pushing:
        shown = list_text(pushing, _NAMES_SHOWN)
        parts.append(f"{len(pushing):,} without url, for export fleet only (connect needs one): {shown}")
    thresholds = dict.fromkeys(entry.thresholds for entry in entries if entry.thresholds)
    for name in thresholds:
        _, further, errors = _check_file(name)
        remarks += further
        for error in errors:
            problems.add(error)
    if thresholds:
        parts.append(f"thresholds: {', '.join(thresholds)}")
    unread = dict.fromkeys(path for entry in entries for path in (entry.token_file, entry.ca) if path)
    if unread:
        parts.append(f"not read here: {', '.join(unread)}")
    return "; ".join(parts)
