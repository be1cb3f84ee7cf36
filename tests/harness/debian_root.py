"""A minimal Debian in a folder, in which packages are installed, started and purged as their users do."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Mapping, Sequence

_NOBODY = ("--reuid=65534", "--regid=65534", "--clear-groups")
_NOT_OF_PACKAGES = ("/proc/", "/dev/", "/sys/", "/tmp/", "/run/", "/var/log/", "/var/cache/", "/var/lib/apt/")
"""What apt itself writes, or what lives shorter than a package."""
_BACKUPS = {"/etc/passwd-", "/etc/group-", "/etc/shadow-", "/etc/gshadow-"}
_SOURCES = Path("/etc/apt/sources.list.d/debian.sources")


class DebianRoot:
    """The folder, and commands in it."""

    def __init__(self, folder: Path) -> None:
        """Installs Debian 12 with apt and nothing else."""
        self.folder = folder
        sources = [str(_SOURCES)] if _SOURCES.exists() else []
        _check(["mmdebstrap", "--quiet", "--mode=root", "--variant=apt", "bookworm", str(folder), *sources])
        _check(["mount", "-t", "proc", "proc", str(folder / "proc")])
        for file in ("resolv.conf", "hosts"):
            shutil.copy(f"/etc/{file}", folder / "etc" / file)
        self.run("apt-get", "-qq", "update")

    def close(self) -> None:
        """Ends the use of the folder, which can be deleted then."""
        _check(["umount", str(self.folder / "proc")])

    def run(self, *command: str, fails: bool = False) -> str:
        """Runs a command as root, which must succeed unless it `fails`; returns its output."""
        return _check(["chroot", str(self.folder), *command], fails=fails)

    def start(
        self, *command: str, variables: Mapping[str, str] | None = None, user: Sequence[str] = _NOBODY
    ) -> subprocess.Popen[str]:
        """Starts a command as another user, nobody by default; its output is in `stdout`."""
        return subprocess.Popen(
            ["chroot", str(self.folder), "setpriv", *user, "--no-new-privs", "--bounding-set=-all", *command],
            env={**_variables(), **(variables or {})},
            umask=0o007,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def install(self, package: Path, *options: str) -> None:
        """Installs a .deb and what it depends on."""
        shutil.copy(package, self.folder / "tmp" / package.name)
        self.run("apt-get", "-qq", "install", "-y", "--no-install-recommends", f"/tmp/{package.name}", *options)

    def unpack(self, package: Path) -> None:
        """Installs a .deb although packages of ROS that it depends on are in no archive here."""
        shutil.copy(package, self.folder / "tmp" / package.name)
        self.run("dpkg", "--install", "--force-depends", f"/tmp/{package.name}")

    def purge(self, package: str) -> None:
        """Removes a package with its configuration."""
        output = self.run("dpkg", "--purge", "--force-depends", package)
        assert "dpkg: error" not in output, output

    def files(self) -> set[str]:
        """Returns the paths of everything, except what apt itself keeps and what Python compiles on its own."""
        found = set()
        for folder, folders, files in os.walk(self.folder):
            place = f"/{os.path.relpath(folder, self.folder)}/".replace("/./", "/")
            folders[:] = [name for name in folders if name != "__pycache__"]
            if place.startswith(_NOT_OF_PACKAGES):
                folders.clear()
                continue
            found |= {place + name for name in [*files, *folders]}
        return found - _BACKUPS

    def users(self) -> set[str]:
        """Returns the names of users and groups."""
        texts = [(self.folder / "etc" / name).read_text() for name in ("passwd", "group")]
        return {line.partition(":")[0] for text in texts for line in text.splitlines()}


def _variables() -> dict[str, str]:
    path = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
    return {"PATH": path, "HOME": "/tmp", "LC_ALL": "C.UTF-8", "DEBIAN_FRONTEND": "noninteractive"}


def _check(command: list[str], fails: bool = False) -> str:
    done = subprocess.run(
        command,
        env=_variables(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=900.0,
        check=False,
    )
    assert (done.returncode != 0) == fails, f"{' '.join(command)} exited with {done.returncode}:\n{done.stdout}"
    return done.stdout
