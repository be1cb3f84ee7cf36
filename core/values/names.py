"""Names of types, topics and nodes, as ROS writes them."""

from __future__ import annotations

import re
from typing import Sequence

_LONG_TYPE = re.compile(r"\A(\w+)/(?:msg|srv|action)/(\w+)\Z")
_NAMESPACE = re.compile(r"/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*/?)?", re.ASCII)


def split_type_name(type_name: str) -> Sequence[str] | None:
    """Splits the name of a type, such as `pkg/Type` or `pkg/msg/Type`, into (package, type); None for other texts."""
    parts = canonical_type(type_name).split("/")
    return parts if len(parts) == 2 and all(part.isidentifier() for part in parts) else None


def canonical_type(type_name: str) -> str:
    """Returns `pkg/Type` for `pkg/msg/Type`, `pkg/srv/Type` and `pkg/action/Type`; another text as it is."""
    return _LONG_TYPE.sub(r"\1/\2", type_name)


def is_namespace(text: str) -> bool:
    """Returns whether a text is a namespace: `carter`, `/fleet/carter`, or empty for none."""
    return _NAMESPACE.fullmatch(text) is not None


def full_name(name: str, namespace: str) -> str:
    """Returns the name of a node in a namespace such as `robot1`, `/fleet/robot1` or, empty, in none.

    >>> full_name("alert_system", "robot1/")
    '/robot1/alert_system'
    """
    return "/".join(["", *filter(None, [namespace.strip("/")]), name])


def resolve_name(name: str, node_name: str) -> str:
    """Resolves a ROS graph name against the fully qualified `node_name`.

    >>> resolve_name("alerts", "/robot1/alert_system")
    '/robot1/alerts'
    >>> resolve_name("~reset", "/robot1/alert_system")
    '/robot1/alert_system/reset'
    """
    if name.startswith("/"):
        return name
    if name.startswith("~"):
        return f"{node_name}/{name[1:].lstrip('/')}"
    return f"{node_name.rpartition('/')[0]}/{name}"
