"""Writes what the pages take from the code: tables of parameters, options, metrics, states, causes and API fields.

    python docs/generate.py

A page marks the place with `<!-- generated: NAME -->` and `<!-- end -->`; a test compares the pages with the code.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import re
import sys
import textwrap
import xml.etree.ElementTree as ElementTree
from functools import partial
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, Mapping, Sequence
from unittest import mock

import yaml

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from robot_health_monitor.__main__ import main
from robot_health_monitor.cli.arguments import COMMANDS
from robot_health_monitor.cli.exit_codes import exit_codes_text
from robot_health_monitor.cli.fleet_configuration import RobotEntry
from robot_health_monitor.core.config import NODE_PARAMETERS, NODES, Parameter
from robot_health_monitor.core.config.monitor_config import MONITOR_PARAMETERS
from robot_health_monitor.core.config.schema import parameters
from robot_health_monitor.core.config.signal_config import CONDITION_PARAMETERS, CONDITIONS, SIGNAL_PARAMETERS
from robot_health_monitor.core.judge.wording import STATES
from robot_health_monitor.core.nodes.aggregator import AGGREGATOR_PARAMETERS
from robot_health_monitor.core.nodes.battery_sensor import SENSOR_PARAMETERS
from robot_health_monitor.core.sensors import configuration as sensing
from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.values.model import Level
from robot_health_monitor.ops.configuration import BlackBoxSettings, HistorySettings, ServerOptions, TargetSettings
from robot_health_monitor.ops.store.samples import SAMPLES_FIELDS
from robot_health_monitor.ops.web import metrics
from robot_health_monitor.ops.web.history_requests import ALERT_FIELDS

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
OWN_FAULT = "check this computer's settings: "
BLOCK = re.compile(r"(<!-- generated: (.+?) -->\n).*?(<!-- end -->)", re.DOTALL)


def pages() -> dict[Path, str]:
    """Returns the text that each page with generated parts should have."""
    blocks = _blocks()
    texts = {page: page.read_text(encoding="utf-8") for page in sorted(DOCS.rglob("*.md"))}
    return {
        page: BLOCK.sub(lambda match: match[1] + blocks[match[2]]() + match[3], text)
        for page, text in texts.items()
        if BLOCK.search(text)
    }


def syntax(*folders: str) -> Iterator[tuple[Path, ast.AST]]:
    """Yields the modules of folders of this repository, with each node of their syntax trees."""
    for folder in folders:
        for file in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                yield file, node


def _own(parameters: Iterable[Parameter]) -> list[Parameter]:
    return [parameter for parameter in parameters if parameter not in NODE_PARAMETERS]


_SENSORS = [each.below(metric) for metric, table in sensing.METRIC_PARAMETERS.items() for each in table]
PARAMETERS: Mapping[str, tuple[Iterable[Parameter], Sequence[str]]] = {
    "signal": (SIGNAL_PARAMETERS, ["alert_system signals.*."]),
    "condition": (CONDITION_PARAMETERS, [f"alert_system signals.*.{key}." for key in CONDITIONS]),
    "node": (NODE_PARAMETERS, [f"{node} " for node in NODES]),
    "alert_system": (_own(MONITOR_PARAMETERS), ["alert_system "]),
    "aggregator": (_own(AGGREGATOR_PARAMETERS), ["aggregator "]),
    "battery_sensor": ([*_own(SENSOR_PARAMETERS), *_SENSORS], ["battery_sensor "]),
    "history": (parameters(HistorySettings), ["ops.yaml history."]),
    "black_box": (parameters(BlackBoxSettings), ["ops.yaml black_box."]),
    "notify": (parameters(TargetSettings), ["ops.yaml notify.*."]),
    "server": (parameters(ServerOptions), ["ops.yaml server."]),
    "fleet": (parameters(RobotEntry), ["fleet.yaml robots.*."]),
}
"""The keys of each table of parameters, and where they stand in the configuration: file or node, and keys above."""


def _blocks() -> Mapping[str, Callable[[], str]]:
    """Returns the functions that write the blocks, by name."""
    return {
        **{f"parameters of {name}": partial(_parameters, table) for name, (table, _) in PARAMETERS.items()},
        **{f"command {name}": partial(_command, name) for name in COMMANDS},
        **{f"API {name}": partial(_fields, name) for name in API},
        "exit codes": _exit_codes,
        "launch arguments": _launch_arguments,
        "metrics": _metrics,
        "sources": _sources,
        "states": lambda: _table(("state", "meaning"), ((f"`{word}`", meaning) for word, meaning in STATES.items())),
        "causes": _causes,
    }


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    lines += [f"| {' | '.join(_escaped(cell) for cell in row)} |" for row in rows]
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    parts = text.replace("|", r"\|").split("`")
    return "`".join(part if number % 2 else part.replace("*", r"\*") for number, part in enumerate(parts))


def _parameters(parameters: Iterable[Parameter]) -> str:
    rows = ((f"`{each.name}`", each.allowed, _default(each.default), each.description) for each in parameters)
    return _table(("key", "value", "default", "meaning"), rows)


def _sources() -> str:
    rows = []
    for name, source in HOST_SOURCES.items():
        options = "; ".join(f"`{option.name}`: {option.description}" for option in source.options)
        rows.append((f"`{name}`", options, source.unit, source.description))
    return _table(("`source`", "options", "unit", "description"), rows)


def _default(default: Any) -> str:
    if default is None or default in ("", ()):
        return ""
    if isinstance(default, Level):
        return f"`{default.name}`"
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    if isinstance(default, tuple):
        return f"`[{', '.join(map(str, default))}]`"
    return f"`{default:g}`" if isinstance(default, float) else f"`{default}`"


def launch_arguments() -> Sequence[ElementTree.Element]:
    """Returns the arguments of the launch file."""
    return ElementTree.parse(ROOT / "launch" / "health_monitor.launch").getroot().findall("arg")


def _launch_arguments() -> str:
    rows = []
    for argument in launch_arguments():
        default = argument.get("default", "").strip().replace("$(find robot_health_monitor)/", "")
        rows.append((f"`{argument.get('name')}`", f"`{default}`" if default else "", argument.get("doc", "")))
    return _table(("argument", "default", "meaning"), rows)


def _parser(*words: str) -> argparse.ArgumentParser:
    """Returns the parser that prints the help of a command, wherever it is assembled."""
    printed: list[argparse.ArgumentParser] = []
    keep = mock.patch.object(argparse.ArgumentParser, "print_help", lambda self, file=None: printed.append(self))
    with keep, contextlib.suppress(SystemExit):
        main([*words, "--help"])
    return printed[0]


def commands_of(parser: argparse.ArgumentParser) -> Sequence[argparse.ArgumentParser]:
    """Returns the parsers of the parts of a command, or its own if it has none."""
    nested = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return [*nested[0].choices.values()] if nested else [parser]


def options_of(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yields the documented options of a command."""
    for action in parser._actions:
        if action.help is not argparse.SUPPRESS and not isinstance(action, argparse._HelpAction):
            yield action


def _command(name: str) -> str:
    parser = _parser(name)
    parts = [_wrapped(parser.description)]
    if (commands := commands_of(parser)) == [parser]:
        return f"{parts[0]}\n{_options(parser)}"
    parts += [f"{_wrapped(f'`{part.prog}`: {part.description}')}\n{_options(part)}" for part in commands]
    return "\n".join([*parts, _wrapped(parser.epilog)])


def _wrapped(text: str | None) -> str:
    return textwrap.fill(_escaped(text or ""), 120, break_long_words=False, break_on_hyphens=False) + "\n"


def _options(parser: argparse.ArgumentParser) -> str:
    rows = []
    for action in options_of(parser):
        shown = names = ", ".join(action.option_strings)
        if action.nargs != 0:
            choices = "|".join(action.choices) if action.choices else None
            value = choices or action.metavar or action.dest.upper()
            values = {"+": f"{value} ...", "*": f"[{value} ...]", "?": f"[{value}]"}.get(str(action.nargs), value)
            shown = f"{names} {values}".strip()
        rows.append((f"`{shown}`", action.help or ""))
    text = _table(("argument", "meaning"), rows)
    return f"{text}\n{_wrapped(parser.epilog)}" if parser.epilog else text


def _exit_codes() -> str:
    codes = (each.split(" ", 1) for each in re.split(r", (?=\d )|: |\.$", exit_codes_text())[1:-1])
    return _table(("code", "meaning"), codes)


def families() -> Iterator[tuple[str, str, str, str]]:
    """Yields name, labels in braces, type and help of each metric, as they are rendered for one signal of one robot."""
    one = [1.0 for _, _, values in metrics._OF_SIGNALS for _ in values]
    robot = metrics.RobotMetrics('robot="r"', {'robot="r",signal="s"': one}, True, 0.0)
    rows: dict[tuple[str, str], tuple[str, str]] = {}
    for profile in metrics.PROFILES:
        text = b"".join(metrics.Metrics().render([robot], profile)).decode()
        for meaning, kind, series in re.findall(r"# HELP \S+ (.*)\n# TYPE \S+ (\w+)\n((?:[^#].*\n)*)", text):
            for line in series.splitlines():
                labels = ",".join(re.findall(r'(\w+)="', line))
                rows.setdefault((re.split("[{ ]", line)[0], f"{{{labels}}}"), (kind, meaning))
    return ((*series, *described) for series, described in rows.items())


def _metrics() -> str:
    rows = [(f"`{name}{labels.replace('{}', '')}`", kind, text) for name, labels, kind, text in families()]
    return _table(("metric", "type", "meaning"), rows)


def _causes() -> str:
    """Returns the causes of a link that is down: the texts of every `Cause`."""
    texts: list[str] = []
    for _, node in syntax("rosbridge/client", "foxglove", "runtime/bridge"):
        if isinstance(node, ast.AnnAssign) and getattr(node.target, "id", "") == "_SYSTEM_ERRORS":
            texts += [text for value in ast.walk(node) for text in _texts(value)]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.args:
            if node.func.id == "Cause":
                texts += _texts(node.args[0])
            elif node.func.id == "_own_fault":
                texts += [f"{OWN_FAULT}{text}" for text in _texts(node.args[0])]
    return "".join(f"* `{text}`\n" for text in sorted({*texts} - {"", "...", f"{OWN_FAULT}..."}))


def _texts(node: ast.AST) -> list[str]:
    """Returns the texts that an expression can have, with `...` for what is known only at run time."""
    if isinstance(node, ast.IfExp):
        return _texts(node.body) + _texts(node.orelse)
    if isinstance(node, ast.JoinedStr):
        return ["".join(str(part.value) if isinstance(part, ast.Constant) else "..." for part in node.values)]
    return [str(node.value)] if isinstance(node, ast.Constant) else []


API: Mapping[str, Mapping[str, str]] = yaml.safe_load((DOCS / "reference" / "api_fields.yaml").read_text("utf-8"))
"""Meaning of the keys of each object. The keys themselves are those that the code sends."""


def _fields(name: str) -> str:
    meanings, sent = API[name], fields_sent(name)
    if list(meanings) != sent:
        raise SystemExit(f"docs/generate.py: API: {name}: the code sends {sent}, described are {list(meanings)}")
    return _table(("key", "meaning"), ((f"`{key}`", meanings[key]) for key in sent))


def fields_sent(name: str) -> list[str]:
    """Returns the keys of an object of the API, from the dictionary in the code that has most of those described."""
    if name in ("samples", "alert"):
        return list(SAMPLES_FIELDS if name == "samples" else ALERT_FIELDS)
    made = [node for _, node in syntax("ops/store", "ops/web") if isinstance(node, ast.Dict)]
    keys = [[key.value for key in node.keys if isinstance(key, ast.Constant)] for node in made]
    sent = max(keys, key=lambda keys: len({*keys} & {*API[name]}))
    return [*sent, "robots"] if name == "state" else sent  # robots are added one by one, as JSON


if __name__ == "__main__":
    for changed, text in pages().items():
        changed.write_text(text, encoding="utf-8")
