"""A node's executable that serves rosbridge clients, seen by this project's own client over a real socket."""

from __future__ import annotations

import re
import signal
from pathlib import Path
from typing import Any, List

from harness.rosbridge_peer import Peer

_SETTINGS = (
    "alert_system:\n  ros__parameters:\n    rosbridge_port: {port}\n    rosbridge_token_file: {token_file}\n"
    "    signals:\n      battery_level: {{warn_below: 20.0}}\n      odometry: {{warn_below: 1.0}}\n"
)


def settings(folder: Path, port: int, token: str) -> str:
    """Returns a thresholds.yaml with a rosbridge server; writes the token to a file in `folder`."""
    file = folder / "token"
    file.write_text(f"{token}\n", encoding="utf-8")
    file.chmod(0o600)
    return _SETTINGS.format(port=port, token_file=file)


async def look_at(port: int, token: str) -> List[Any]:
    """Returns what a client sees: a battery level, the answer of `reset`, that of a service that it may not call."""
    import aiohttp

    headers = {"Authorization": f"Bearer {token}"}
    url = f"http://127.0.0.1:{port}/"
    async with aiohttp.ClientSession(headers=headers) as session, session.ws_connect(url) as socket:
        peer = Peer(socket)
        reset = await peer.call("/alert_system/reset")
        refused = await peer.call("/alert_system/set_logger_level")
        await peer.subscribe("/battery_level", type="std_msgs/Float32")
        level = await peer.receive()
        parameters = (await peer.call("/rosapi/get_param_names"))["values"]["names"]
        return [level["msg"]["data"], reset["values"], refused["values"], parameters]


def check_served(process: Any, seen: List[Any]) -> None:
    """Checks what `look_at` saw of `health_monitor`, and that the process ends as it should."""
    level, reset, refused, parameters = seen
    assert 0.0 <= level <= 100.0
    assert reset == {"success": True, "message": "reset: nothing was latched"}
    assert refused == "clients may not call /alert_system/set_logger_level"
    assert "/alert_system:signals.battery_level.warn_below" in parameters
    assert "/alert_system:rosbridge_token" not in parameters
    process.signal(signal.SIGINT)
    assert process.wait() == 0
    assert not re.search("Traceback|ERROR", process.text)
