"""Writes docs/reference/names.txt: every name that docs/reference/stability.md promises to keep.

    python docs/list_names.py

A test compares the file with the code. Names may be added at any time. From version 1.0.0 on, a name
may be removed only with a new major version; otherwise this program refuses to remove it.
"""

from __future__ import annotations

import inspect
import itertools
import re
import sys
from pathlib import Path
from typing import Any, Iterator, Sequence

sys.path.insert(0, str(Path(__file__).resolve().parent))
import generate

from robot_health_monitor import core
from robot_health_monitor.cli.arguments import COMMANDS
from robot_health_monitor.cli.executables import EXECUTABLES
from robot_health_monitor.cli.exit_codes import ExitCode
from robot_health_monitor.cli.fleet_configuration import Options
from robot_health_monitor.cli.history.history_entries import CSV_HEAD
from robot_health_monitor.core import nodes
from robot_health_monitor.core.config.schema import parameters
from robot_health_monitor.core.nodes.outlets import FIELDS
from robot_health_monitor.core.port import LocalBus
from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.values.version import package_version
from robot_health_monitor.ops.store.samples import SAMPLES_FIELDS
from robot_health_monitor.ops.web.interface import WebInterface
from robot_health_monitor.runtime.tokens import TOKEN_VARIABLE

FILE = generate.DOCS / "reference" / "names.txt"
HEAD = "# What docs/reference/stability.md promises, as of version {version}. Written by docs/list_names.py.\n"

MONITOR_METHODS = ("observe", "set_link", "tick", "skip", "report", "status", "reset", "configure", "end")
"""Its other methods serve the adapters and may change."""
MADE_BY_USERS = (core.Sample, core.Monitor, core.Notice)
"""Classes whose constructors are promised; of the others, the fields are."""
FOR_ADAPTERS = {"history", "announce_pauses", "silence_of", "black_box_of", "self_report", "computer"}
"""Arguments of nodes that serve the adapters and may change."""
BUS_METHODS = ("node", "call_service", "next_due_s", "run_due", "run_until")


def names() -> list[str]:
    """Returns the names in the code, sorted: `KIND NAME`."""
    return sorted(
        {
            *_library(),
            *_keys(),
            *_options(),
            *(f"launch argument {each.get('name')}" for each in generate.launch_arguments()),
            *(f"executable {name}" for name in (*EXECUTABLES, "robot-health")),
            *_graph(),
            *(f"metric {name}{labels}" for name, labels, *_ in generate.families()),
            *(f"API {name} {key}" for name in generate.API for key in generate.fields_sent(name)),
            *_routes(),
            *(f"alert in JSON {field}" for field in FIELDS),
            *(f"column of history --csv {column}" for column in CSV_HEAD),
            *(f"column of history --samples --csv {column}" for column in SAMPLES_FIELDS),
            *(f"exit code {code.value} {code.name}" for code in ExitCode),
            f"variable {TOKEN_VARIABLE}",
        }
    )


def _library() -> Iterator[str]:
    for name in core.__all__:
        yield from _described(f"library core.{name}", getattr(core, name))
    for name in MONITOR_METHODS:
        yield from _call(f"library core.Monitor.{name}", getattr(core.Monitor, name))
    for name in nodes.__all__:
        yield from _call(f"library core.nodes.{name}", getattr(nodes, name))
    yield from _call("library core.port.LocalBus", LocalBus)
    for name in BUS_METHODS:
        yield from _call(f"library core.port.LocalBus.{name}", getattr(LocalBus, name))


def _described(name: str, found: Any) -> Iterator[str]:
    """Yields a public name, with the arguments of a call and the fields of values and errors."""
    if found in MADE_BY_USERS or inspect.isfunction(found):
        yield from _call(name, found)
    else:
        yield name
    if inspect.isclass(found):
        fields = [*getattr(found, "__dataclass_fields__", ()), *getattr(found, "_fields", ())]
        if found is core.ConfigError:
            fields = [*vars(core.ConfigError("")), "others"]
        members = getattr(found, "__members__", ())
        properties = [each for each, value in vars(found).items() if isinstance(value, property)]
        yield from (f"{name}.{each}" for each in (*members, *fields, *properties))


def _call(name: str, function: Any) -> Iterator[str]:
    """Yields a call with its required arguments, and one with each optional argument, as more of these may be added."""
    found = inspect.signature(function).parameters.values()
    arguments = [each for each in found if each.name != "self" and each.name not in FOR_ADAPTERS]
    required = [each.name for each in arguments if each.default is each.empty]
    yield f"{name}({', '.join(required)})"
    yield from (f"{name}({each.name}=)" for each in arguments if each.default is not each.empty)


def _keys() -> Iterator[str]:
    """Yields the keys of all configuration files, and the words that they accept."""
    for table, places in [*generate.PARAMETERS.values(), (parameters(Options), ["fleet.yaml defaults."])]:
        for place, parameter in itertools.product(places, table):
            yield f"key {place}{parameter.name}"
            yield from (f"key {place}{parameter.name}: {choice}" for choice in filter(None, parameter.choices))
    for source, description in HOST_SOURCES.items():
        yield f"key battery_sensor host.*.source: {source}"
        yield from (f"key battery_sensor host.*.{option.name} of {source}" for option in description.options)


def _options() -> Iterator[str]:
    for command in COMMANDS:
        yield f"command {command}"
        for part in generate.commands_of(generate._parser(command)):
            called = part.prog.partition(" ")[2]
            yield f"command {called}"
            for action in generate.options_of(part):
                shown = action.option_strings or [str(action.metavar or action.dest.upper())]
                yield from (f"option {called} {name}" for name in shown)


def _graph() -> Iterator[str]:
    """Yields the topics and services of the nodes, and the keys of their statuses, from nodes that run here."""
    bus = LocalBus()
    outside = bus.node("outside")
    statuses: dict[str, set[str]] = {}

    def take(message: Any, now_s: float) -> None:
        for status in message["status"]:
            statuses.setdefault(status["name"], set()).update(pair["key"] for pair in status["values"])

    outside.subscribe("/diagnostics", "diagnostic_msgs/DiagnosticArray", take)
    nodes.AlertSystem(bus.node("alert_system"))
    nodes.Aggregator(bus.node("aggregator"))
    nodes.BatterySensor(bus.node("battery_sensor"))
    bus.run_until(4.0)
    graph = bus.graph()
    for node, info in graph.nodes.items():
        yield from (f"topic {node[1:]} publishes {topic} {graph.topics[topic]}" for topic in info.publishes)
        yield from (f"service {service} {graph.services[service]}" for service in info.services)
    yield "service /alert_system/reload std_srvs/Trigger (ROS 1)"
    yield from (f"status alert_system: monitor {key}" for key in statuses["alert_system: monitor"])
    signal = statuses["alert_system: battery_level"] & statuses["alert_system: temperature"]
    yield from (f"status alert_system: SIGNAL {key}" for key in signal)


def _routes() -> Iterator[str]:
    routes = re.findall(r'\b(get|post)\("([^"]+)', inspect.getsource(WebInterface.routes))
    yield from (f"request {method.upper()} {path}" for method, path in routes)


def promised() -> Sequence[str]:
    """Returns the names in the file."""
    return [line for line in FILE.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]


def difference(before: Sequence[str], now: Sequence[str]) -> str:
    """Returns what to do about names that are in one list only; empty: nothing."""
    lines = [f"- {name}" for name in before if name not in now]
    if lines:
        lines.append("Users rely on these names. Keep each beside its new one;")
        lines.append("only a new major version may remove it: docs/reference/stability.md.")
    added = [f"+ {name}" for name in now if name not in before]
    if added:
        lines += [*added, "These names are new: python docs/list_names.py writes them down."]
    return "\n".join(lines)


def may_remove(written: str, version: str) -> bool:
    """Returns whether names of the version `written` may go in `version`: before 1.0.0, and in a new major version."""
    before, now = (int(each.partition(".")[0]) for each in (written, version))
    return before == 0 or now > before


def write() -> None:
    """Writes the file; ends the process with what to do if names that it has may not be removed."""
    before, now = promised(), names()
    (written,) = re.findall(r"as of version (\S+)\. ", FILE.read_text(encoding="utf-8"))
    removed = [name for name in before if name not in now]
    if removed and not may_remove(written, package_version()):
        raise SystemExit(difference(removed, []))
    FILE.write_text(HEAD.format(version=package_version()) + "".join(f"{name}\n" for name in now), encoding="utf-8")


if __name__ == "__main__":
    write()
