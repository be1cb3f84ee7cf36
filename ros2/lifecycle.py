"""States of lifecycle nodes, read without waiting: each call is answered until the next reading, or not at all."""

from __future__ import annotations

from typing import Any, Collection

from . import messages


class LifecycleStates:
    """Calls the service `get_state` of nodes. Used in one thread, while an executor spins the node."""

    def __init__(self, node: Any) -> None:
        """Calls nothing yet."""
        self._node = node
        self._calls: dict[str, tuple[Any, Any]] = {}
        """Client and the future of its last call by name of the node."""

    def read(self, names: Collection[str]) -> dict[str, float]:
        """Returns the ids of the states that were answered since the last reading, and calls again."""
        for name in self._calls.keys() - set(names):
            self._node.destroy_client(self._calls.pop(name)[0])
        states: dict[str, float] = {}
        for name in names:
            client, future = self._calls.get(name, (None, None))
            if client is None:
                client = self._node.create_client(
                    messages.service_class("lifecycle_msgs/GetState"), f"{name}/get_state"
                )
            elif future is not None and future.done() and future.exception() is None:
                states[name] = float(future.result().current_state.id)
            elif future is not None:
                client.remove_pending_request(future)
            is_ready = client.service_is_ready()
            self._calls[name] = client, client.call_async(client.srv_type.Request()) if is_ready else None
        return states
