"""`robot-health init`: a first thresholds.yaml from a live robot."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from typing import Any, Dict, Set, Tuple

from ...core.values.errors import ServiceError
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
    from ...core.proposal.nodes import Nodes
    from ...core.proposal.proposal import PUBLISHED_HERE, Proposal
    from ...core.proposal.suggestion import LEAST_RANGE_S
    from ...core.proposal.thresholds_file import thresholds_text
    from ...core.values.formatting import duration_text, printable

    namespace = arguments.namespace.strip("/")
    watched = _Watched(arguments.against, namespace) if arguments.against else None
    proposal = Proposal(namespace, ages_of_bulk=not arguments.url, taken=watched.names if watched else ())
    nodes = Nodes()
    robot, listened_s, is_complete = _listen(arguments, proposal, nodes, interrupts)
    for problem in proposal.problems:
        sys.stderr.write(f"{printable(f'WARN: {problem}')}\n")
    proposed = proposal.result()
    heard = _heard(proposal)
    if not proposed.signals:
        # First a topic that has messages, but not enough.
        dull = ("a topic of the middleware", "no ", PUBLISHED_HERE)
        reasons = sorted(proposed.not_watched.items(), key=lambda item: (item[1].startswith(dull), item))
        more = f" ({reasons[0][0]}: {reasons[0][1]})" if reasons else ""
        if reasons and reasons[0][1].startswith(dull) and proposal.own_topics:
            more = ": only this monitor publishes there; start the robot's drivers"
        elif proposal.samples:
            longer_s = max(_USUAL_S, proposal.needed_s(("rate", "number", "elements")))
            more += f"; --seconds {longer_s:.0f} listens longer" if longer_s > listened_s else ""
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
        *([f"Only what {arguments.against} does not watch."] if watched else []),
        *([_COMMENTED] if listened_s < LEAST_RANGE_S else []),
        *(
            [f"Some came too rarely to show their range: `--seconds {needed_s:.0f}` is long enough."]
            if needed_s
            else []
        ),
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
    from ...core.values.formatting import count_text

    return f"{count_text(len(proposal.topics), 'topic')}, {count_text(proposal.samples, 'message')}"


class _Watched:
    """What a thresholds.yaml watches."""

    def __init__(self, file: str, namespace: str) -> None:
        from ...core.config.monitor_config import load_config
        from ...core.values.names import resolve_name

        node = f"/{namespace}/alert_system" if namespace else "/alert_system"
        config = load_config(file)
        self.names = tuple(config.signals)
        self._topics: Dict[str, Set[str]] = {}
        for signal in config.signals.values():
            for topic in signal.topics:
                self._topics.setdefault(resolve_name(topic, node), set()).add(signal.field)
            if signal.graph is not None:
                key, name = signal.graph
                self._topics.setdefault(f"{key} {resolve_name(name, node)}", set()).add(signal.field)

    def remove_from(self, proposed: Any) -> None:
        """Removes the signals whose topic and field are watched, and the remarks about topics that are."""
        from ...core.values.patterns import matches_pattern

        proposed.signals = [
            signal
            for signal in proposed.signals
            if not any(
                matches_pattern(signal.given.get("field", "data"), each) for each in self._topics.get(signal.topic, ())
            )
        ]
        proposed.not_watched = {
            topic: reason for topic, reason in proposed.not_watched.items() if topic not in self._topics
        }
        if all(signal.is_shown_only for signal in proposed.signals):
            proposed.signals = []
