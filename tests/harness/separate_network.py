"""A network of two machines: network namespaces for the processes of a monitor and of a robot. The link can be cut.

Nothing of it is seen outside: a browser gives up what it loads whenever an address of its machine changes.
"""

from __future__ import annotations

import os
import random
import shutil
import subprocess
from typing import NamedTuple

import pytest


class Machine(NamedTuple):
    """A network namespace."""

    name: str
    address: str

    @property
    def command(self) -> list[str]:
        """What to write before a command to run it there."""
        return ["ip", "netns", "exec", self.name]


class SeparateNetwork:
    """Two machines that are connected by one virtual cable."""

    def __init__(self) -> None:
        """Creates it; skips the test where this user may not."""
        if os.geteuid() != 0 or not shutil.which("ip"):
            pytest.skip("a network namespace needs root and iproute2")
        number = f"{random.SystemRandom().randrange(16**6):06x}"
        # 198.18.0.0/15 is for tests of networks (RFC 2544).
        self.monitor = Machine(f"monitor-{number}", "198.18.0.1")
        self.robot = Machine(f"robot-{number}", "198.18.0.2")
        try:
            for machine in (self.monitor, self.robot):
                self._ip("netns", "add", machine.name)
            ends = [("name", "cable", "netns", machine.name) for machine in (self.monitor, self.robot)]
            self._ip("link", "add", *ends[0], "type", "veth", "peer", *ends[1])
        except subprocess.CalledProcessError as error:
            self.close()
            pytest.skip(f"no network namespace: {error.stderr.strip()}")
        for machine in (self.monitor, self.robot):
            self._ip("-n", machine.name, "addr", "add", f"{machine.address}/30", "dev", "cable")
            for device in ("cable", "lo"):
                self._ip("-n", machine.name, "link", "set", device, "up")
            self._ip("-n", machine.name, "route", "add", "default", "dev", "cable")  # for multicast

    def cut(self) -> None:
        """Cuts the link. Connections stay open; nothing arrives."""
        self._ip("-n", self.monitor.name, "link", "set", "cable", "down")

    def mend(self) -> None:
        """Connects both ends again."""
        self._ip("-n", self.monitor.name, "link", "set", "cable", "up")

    def close(self) -> None:
        """Removes it, with the cable."""
        for machine in (self.monitor, self.robot):
            subprocess.run(["ip", "netns", "del", machine.name], capture_output=True, check=False)

    @staticmethod
    def _ip(*arguments: str) -> None:
        subprocess.run(["ip", *arguments], capture_output=True, text=True, check=True)
