"""The client of a robot's bridge, which its address chooses."""

from __future__ import annotations

from typing import Any

from ..foxglove import FoxgloveClient
from ..rosbridge.client import RosbridgeClient
from ..runtime.bridge.address import is_foxglove
from ..runtime.bridge.node import BridgeClient


def bridge_client(url: str, **options: Any) -> BridgeClient[Any]:
    """Returns a client that is not connected and only reads, with the options that both clients have.

    Raises ConfigError if `url` is not the address of a server.
    """
    return FoxgloveClient(url, **options) if is_foxglove(url) else RosbridgeClient(url, read_only=True, **options)
