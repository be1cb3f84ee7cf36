"""`robot-health init`: a first thresholds.yaml from a live robot."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from typing import Any, List, Tuple

from ...core.values.errors import ServiceError
from ...core.values.formatting import count_text, duration_text, list_text, printable
from ...runtime.interrupts import Interrupts
from ...runtime.libraries import ROSBRIDGE, libraries
from ..arguments import Parser, add, add_robot_server, seconds

_SHORTEST_S = 1.0
_USUAL_S = 60.0
_COMMENTED = (
    "Numbers without a rule get bounds after 10 minutes (`--seconds 660`): until then, what was seen is a comment."
)


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Listens to a live robot, and writes a commented thresholds.yaml to stdout: for the arrivals of every periodic "
        "topic, the age of stamps, batteries, temperatures, /diagnostics, frames, errors in the log, and the nodes "
        "that publish all that. Started with the result, the same robot raises no alert. Nothing is published on the "
        "robot. An interrupt ends the listening early."
    )
    add(
        parser,
        "[URL]",
        "bridge of the robot: ws://host:port or host:port (rosbridge), wss://host:port, foxglove://host:port "
        "(default: the ROS that is sourced here)",
    )
    meaning = f"how long to listen (default: {_USUAL_S:g})"
    add(parser, "--seconds SECONDS", meaning, type=seconds, default=_USUAL_S)
    add(parser, "--ros1", "listen over ROS 1, if both are there")
    add(parser, "--ros2", "listen over ROS 2, if both are there")
    add(parser, "--against FILE", "write only what the robot has and this thresholds.yaml does not watch")
    add_robot_server(parser, "robot's")
    parser.check = _check


def _check(arguments: argparse.Namespace) -> str:
    if sum((bool(arguments.url), arguments.ros1, arguments.ros2)) > 1:
        return "expected one of URL, --ros1 and --ros2"
    if arguments.seconds < _SHORTEST_S:
        return f"argument --seconds: expected at least {_SHORTEST_S:g}"
    return ""


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> None:
    """Writes the thresholds. Raises ServiceError if there is nothing to watch."""
    from ...core.proposal.candidates import Candidates
    from ...core.proposal.nodes import Nodes
    from ...core.proposal.proposal import Proposal
    from ...core.proposal.suggestion import LEAST_RANGE_S
    from ...core.proposal.thresholds_file import thresholds_text

    namespace = arguments.namespace.strip("/")
    watched = _Watched(arguments.against, namespace) if arguments.against else None
    candidates = Candidates(namespace, watched.names if watched else (), ages_of_bulk=not arguments.url)
    proposal = Proposal(candidates)
    nodes = Nodes()
    robot, listened_s, is_complete = _listen(arguments, proposal, nodes, interrupts)
    for problem in candidates.problems:
        sys.stderr.write(f"{printable(f'WARN: {problem}')}\n")
    proposed = proposal.result()
    heard = _heard(proposal)
    if not proposed.signals:
        reasons = [f"{topic}: {reason}" for topic, reason in sorted(proposed.not_watched.items())]
        more = f" ({list_text(reasons, 5)})" if reasons else ""
        longer_s = max(_USUAL_S, proposal.needed_s(("rate", "number", "elements")))
        if proposal.samples and longer_s > listened_s:
            more += f"; --seconds {longer_s:.0f} listens longer"
        raise ServiceError(f"nothing to watch on {robot}: {heard} in {duration_text(listened_s)}{more}")
    nodes.add_to(proposed, proposal)
    if watched is not None:
        watched.remove_from(proposed)
        if not proposed.signals:
            sys.stderr.write(f"{printable(f'{arguments.against} watches everything on {robot} that can be watched')}\n")
            return
    needed_s = proposal.needed_s()
    lasted = f"{duration_text(listened_s)}{'' if is_complete else ', interrupted'}"
    heading = [
        f"Written by `robot-health init` after listening to {robot} for {lasted}: {heard}.",
        *([f"Only what {arguments.against} does not watch."] * bool(watched)),
        *([_COMMENTED] * (listened_s < LEAST_RANGE_S)),
        *([f"Some came too rarely to show their range: `--seconds {needed_s:.0f}` is long enough."] * bool(needed_s)),
        "docs/statistics.md explains how each value is computed. Review before use.",
    ]
    sys.stdout.write(thresholds_text(heading, {}, proposed))


def _listen(
    arguments: argparse.Namespace, proposal: Any, nodes: Any, interrupts: Interrupts
) -> Tuple[str, float, bool]:
    """Returns the robot's name, for how long it was listened to, in s, and whether that was not interrupted."""
    from ..live_robot import bridged_robot, choose_ros, listen, ros_robot
    from ..output.lines import ProgressLine

    progress = ProgressLine()

    def show(listened_s: float) -> None:
        progress.show(f"listening: {listened_s:.0f} of {arguments.seconds:g} s, {_heard(proposal)}; Ctrl-C to end")

    if arguments.url:
        with libraries(*ROSBRIDGE):
            from .. import fleet  # noqa: F401 - names what is missing

        from ..fleet_configuration import FleetReader, Options, read_addresses

        options = Options(token_file=arguments.robot_token_file, ca=arguments.ca)
        warn = partial(print, file=sys.stderr)
        (robot,) = FleetReader(read_addresses([arguments.url]), "", options, warn).read()
        name = robot.name
        opened = bridged_robot(robot.url, interrupts, token=robot.token, ssl_context=robot.ssl_context)
    else:
        ros = choose_ros("ros1" if arguments.ros1 else "ros2" if arguments.ros2 else "")
        name, opened = f"ROS {ros[-1]}", ros_robot(ros, interrupts)
    try:
        with opened as found:
            return (name, *listen(found, proposal, nodes, arguments.seconds, interrupts, show))
    finally:
        progress.clear()


def _heard(proposal: Any) -> str:
    return f"{count_text(len(proposal.candidates.topics), 'topic')}, {count_text(proposal.samples, 'message')}"


class _Watched:
    """What a thresholds.yaml watches."""

    def __init__(self, file: str, namespace: str) -> None:
        from ...core.config.monitor_config import load_config
        from ...core.values.names import resolve_name

        node = f"/{namespace}/alert_system" if namespace else "/alert_system"
        config = load_config(file)
        self.names = tuple(config.signals)
        self._fields: List[Tuple[str, str]] = []
        """Topics or parts of the graph, as signals that are proposed have them, and their fields."""
        for signal in config.signals.values():
            self._fields += [(resolve_name(topic, node), signal.field) for topic in signal.topics]
            if signal.graph is not None:
                key, name = signal.graph
                self._fields.append((f"{key} {resolve_name(name, node)}", signal.field))

    def remove_from(self, proposed: Any) -> None:
        """Removes the signals whose topic and field are watched, and the remarks about topics that are."""
        from ...core.values.patterns import matches_pattern

        def is_watched(signal: Any) -> bool:
            field = signal.given.get("field", "data")
            return any(topic == signal.topic and matches_pattern(field, each) for topic, each in self._fields)

        proposed.signals = [signal for signal in proposed.signals if not is_watched(signal)]
        for topic, _ in self._fields:
            proposed.not_watched.pop(topic, "")
        if all(signal.is_shown_only for signal in proposed.signals):
            proposed.signals = []
