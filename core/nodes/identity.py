"""What the nodes have in common: their base name, and parameters that are fixed at the start."""

from __future__ import annotations

from ..errors import ConfigError
from ..middleware import Middleware

FLOAT_TYPE = "std_msgs/Float32"
DIAGNOSTICS = "/diagnostics"


def base_name(middleware: Middleware) -> str:
    """Returns the node's name without its namespace."""
    return middleware.name.rpartition("/")[2]


def refuse_change(name: str, old: object, new: object) -> None:
    """Raises ConfigError if a parameter that is fixed at the start would change."""
    if new != old:
        raise ConfigError("can only be given at the start", (name,))
