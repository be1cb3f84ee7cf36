"""A network of two: this machine, and a network namespace for the processes of a robot. The link can be cut."""

from __future__ import annotations

import os
import random
import shutil
import subprocess

import pytest

_CHANCE = random.SystemRandom()


class SeparateNetwork:
    """A namespace that is connected with this machine by one virtual cable."""

    def __init__(self) -> None:
        """Creates it; skips the test where this user may not."""
        if os.geteuid() != 0 or not shutil.which("ip"):
            pytest.skip("a network namespace needs root and iproute2")
        number = f"{_CHANCE.randrange(16**6):06x}"
        self._name = f"robot-{number}"
        self._cable, inner = f"rh{number}a", f"rh{number}b"
        # 198.18.0.0/15 is for tests of networks (RFC 2544).
        base = f"198.18.{_CHANCE.randrange(256)}.{_CHANCE.randrange(64) * 4}"
        prefix, _, last = base.rpartition(".")
        self.here, self.there = (f"{prefix}.{int(last) + place}" for place in (1, 2))
        """Addresses of this machine and of the namespace."""
        try:
            self._ip("netns", "add", self._name)
            self._ip("link", "add", self._cable, "type", "veth", "peer", "name", inner, "netns", self._name)
        except subprocess.CalledProcessError as error:
            self.close()
            pytest.skip(f"no network namespace: {error.stderr.strip()}")
        self._ip("addr", "add", f"{self.here}/30", "dev", self._cable)
        self._ip("link", "set", self._cable, "up")
        self._ip("-n", self._name, "addr", "add", f"{self.there}/30", "dev", inner)
        self._ip("-n", self._name, "link", "set", inner, "up")
        self._ip("-n", self._name, "link", "set", "lo", "up")

    @property
    def command(self) -> list[str]:
        """What to write before a command to run it in the namespace."""
        return ["ip", "netns", "exec", self._name]

    def cut(self) -> None:
        """Cuts the link. Connections stay open; nothing arrives."""
        self._ip("link", "set", self._cable, "down")

    def mend(self) -> None:
        """Connects both ends again."""
        self._ip("link", "set", self._cable, "up")

    def close(self) -> None:
        """Removes it, with the cable."""
        subprocess.run(["ip", "netns", "del", self._name], capture_output=True, check=False)

    @staticmethod
    def _ip(*arguments: str) -> None:
        subprocess.run(["ip", *arguments], capture_output=True, text=True, check=True)
