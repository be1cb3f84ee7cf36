"""Counts nodes and endpoints in a robot's graph, for the signals `node`, `publishers`, `subscribers`, `lifecycle`."""

from __future__ import annotations

from typing import Callable, Collection, Counter, Dict, Iterable, NamedTuple, Tuple, Union

from ..values import JsonObject, matches_pattern

Wanted = Tuple[str, str]
"""One of `GRAPH_KEYS`, and a resolved name or pattern."""

Counts = Dict[Wanted, float]
"""How many there are of each, or the id of the lifecycle state (0 if the node is not there).

What is not known now is missing.
"""


class Unread(NamedTuple):
    """Why the graph cannot be read."""

    reason: str
    is_watched: bool = True
    """False while it has never been read here: its signals are not watched until it is."""


GraphCallback = Callable[[Union[Counts, Unread], float], None]
"""Receives what was counted, or why nothing was, with the time in s."""

NOT_COUNTED = "/rosout"
"""The node of ROS 1 that collects the log."""


def is_pattern(name: str) -> bool:
    """Whether a name may match several."""
    return "*" in name or "?" in name


def matching(wanted: Collection[Wanted], key: str, names: Iterable[str]) -> set[str]:
    """Returns the names that are counted for a key."""
    exact = {name for its_key, name in wanted if its_key == key}
    patterns = list(filter(is_pattern, exact))  # most are names, and need no comparison with each of `names`
    return {each for each in names if each in exact or any(matches_pattern(each, pattern) for pattern in patterns)}


def count(
    wanted: Collection[Wanted], nodes: Iterable[str], publishers: Iterable[str], subscribers: Iterable[str]
) -> Counts:
    """Counts what is wanted, but for lifecycle states.

    `publishers` and `subscribers` are topics, each once per endpoint that is not of this monitor.

    >>> count([("node", "/lidar_*")], ["/lidar_left", "/lidar_right"], [], [])
    {('node', '/lidar_*'): 2.0}
    """
    numbers = {"node": Counter(nodes), "publishers": Counter(publishers), "subscribers": Counter(subscribers)}
    counts: Counts = {}
    for key, name in wanted:
        if key in numbers:
            names = matching([(key, name)], key, numbers[key]) if is_pattern(name) else [name]
            counts[key, name] = float(sum(numbers[key][each] for each in names))
    return counts


def state_of(response: JsonObject) -> float:
    """Returns the id in a response of lifecycle_msgs/GetState; raises LookupError, TypeError or ValueError."""
    return float(response["current_state"]["id"])
