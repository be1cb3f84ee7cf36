"""The commands of the README of `robot-health export fleet`, run as printed; what they install then works.

Only /etc and /var become folders of the test, and what changes a machine is recorded: apt-get, systemctl, groups.
With https, the certificate of the centre is real, of an authority that only this test's agents trust.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import ssl
import subprocess
import urllib.error
import urllib.request
from pathlib import Path
from typing import Iterator

import pytest
from harness.prometheus_server import needs_prometheus
from harness.pushing_fleet import Scraped, until
from harness.reserved import free_port
from harness.victoria_metrics import needs_victoria_metrics

from robot_health_monitor.core import load_config
from robot_health_monitor.ops.export.fleet import FleetSettings, export_fleet, write_files

pytestmark = [needs_prometheus, needs_victoria_metrics, pytest.mark.newest_python]
STANDINS = {
    "apt-get": 'echo "apt-get $*" >> "$DONE"',
    "systemctl": 'echo "systemctl $*" >> "$DONE"',
    "chgrp": "test $# = 2 -a -f $2",
    "install": 'words=(); while [ $# -gt 0 ]; do if [ "$1" = -g ]; then shift; else words+=("$1"); fi; shift; done\n'
    '/usr/bin/install "${words[@]}"',
    # Debian's package apache2-utils, which may not be installed here.
    "htpasswd": "read -r password\n"
    r'''perl -e 'print "robots:", crypt($ARGV[0], "\$2y\$10\$" . "a" x 22), "\n\n"' "$password"''',
}


class Installed:
    """What the commands have installed, and what they asked of the machine."""

    def __init__(self, root: Path, scheme: str, address: str) -> None:
        """Exports the files, and runs the commands."""
        self.root = root
        self.port = port = free_port()
        self._receiver = f"{scheme}://localhost:{port}"
        self._trusted = ""
        config = load_config({"signals": {"battery_level": {"warn_below": 20.0}}})
        settings = FleetSettings(f"{self._receiver}/api/v1/write", 86_400.0, 1.0, 900.0, [address])
        exported = export_fleet(settings, config)
        write_files(str(root / "out"), exported)
        for name, text in STANDINS.items():
            if name != "htpasswd" or shutil.which(name) is None:
                (root / "bin").mkdir(exist_ok=True)
                (root / "bin" / name).write_text(f"#!/bin/bash\n{text}\n")
                (root / "bin" / name).chmod(0o755)
        for folder in ("etc/systemd/system", "etc/robot-health"):  # the second is the monitor's own
            (root / folder).mkdir(parents=True)
        if scheme == "https":
            (root / "etc/robot-health-centre").mkdir()
            self._trusted = certify(root / "etc/robot-health-centre", root / "authority")
        commands = re.findall(r"```bash\n(.*?)```", exported["README.md"], re.DOTALL)
        assert len(commands) == 6, commands
        environment = {"PATH": f"{root / 'bin'}:{os.environ['PATH']}", "DONE": str(root / "done")}
        script = "set -e\n" + "\n".join(commands).replace("/etc/", f"{root}/etc/")
        subprocess.run(["bash", "-c", script], cwd=root / "out", env=environment, check=True, timeout=60)
        self.asked: list[str] = (root / "done").read_text().splitlines()
        self.password = (root / "etc/robot-health/receiver.password").read_text().strip()
        self._processes: list[subprocess.Popen[bytes]] = []

    def start(self, unit: str, *, trusting: bool = True) -> None:
        """Starts the command of an installed unit, on a machine that trusts the authority of the centre."""
        text = (self.root / f"etc/systemd/system/{unit}.service").read_text()
        for old, new in {
            "=/etc/": f"={self.root}/etc/",
            "/var/lib/": f"{self.root}/",
            f"=:{self.port} ": f"=127.0.0.1:{self.port} ",
            "127.0.0.1:9095": f"127.0.0.1:{free_port()}",
            "127.0.0.1:8429": f"127.0.0.1:{free_port()}",
        }.items():
            text = text.replace(old, new)
        command = re.search(r"ExecStart=((?:.|\\\n)*?)\nExec", text)
        assert command is not None
        environment = {"SSL_CERT_FILE": self._trusted if trusting else "/dev/null", "SSL_CERT_DIR": "/nonexistent"}
        for file in re.findall(r"EnvironmentFile=(.+)", text):
            environment.update(line.split("=", 1) for line in Path(file).read_text().splitlines())
        with (self.root / f"{unit}.log").open("wb") as log:
            words = shlex.split(command[1].replace("\\\n", " "))
            self._processes.append(subprocess.Popen(words, stdout=log, stderr=log, env=environment))

    def query(self, user: str, password: str) -> str:
        """Returns the result of a query, or the code of a refusal."""
        manager = urllib.request.HTTPPasswordMgrWithPriorAuth()
        url = f"{self._receiver}/api/v1/query?query=robot_health_value&nocache=1"
        manager.add_password(None, url, user, password, is_authenticated=True)
        tls = urllib.request.HTTPSHandler(context=ssl.create_default_context(cafile=self._trusted or None))
        basic = urllib.request.HTTPBasicAuthHandler(manager)
        try:
            opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), tls, basic)
            with opener.open(url, timeout=10.0) as answer:
                text: str = answer.read().decode()
                return text
        except urllib.error.HTTPError as error:
            return str(error.code)
        except OSError as error:
            return str(error)

    def end(self) -> None:
        """Ends what was started."""
        for process in self._processes:
            process.kill()
            process.wait()
        self._processes.clear()


def certify(centre: Path, authority: Path) -> str:
    """Makes an authority, and a certificate of it for the centre; returns the file that clients must trust."""
    authority.mkdir()
    key = ["openssl", "req", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-x509"]
    ca = ["-keyout", str(authority / "ca.key"), "-out", str(authority / "ca.crt"), "-subj", "/CN=authority"]
    ca += ["-addext", "keyUsage=critical,keyCertSign"]
    own = ["-CA", str(authority / "ca.crt"), "-CAkey", str(authority / "ca.key"), "-subj", "/CN=localhost"]
    own += ["-addext", "subjectAltName=DNS:localhost", "-addext", "basicConstraints=critical,CA:FALSE"]
    files = ["-keyout", str(centre / "tls.key"), "-out", str(centre / "tls.crt")]
    for command in ([*key, *ca], [*key, *own, *files]):
        subprocess.run(command, check=True, capture_output=True, timeout=60)
    return str(authority / "ca.crt")


@pytest.fixture(scope="module", params=["http", "https"])
def installed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Installed]:
    folder = tmp_path_factory.mktemp("installed")
    robot = Scraped(lambda: b'robot_health_value{robot="r1",signal="battery_level"} 80\n')
    made = Installed(folder, request.param, robot.address)
    for file in (folder / "etc").rglob("*.y*ml"):  # the folders that files name
        file.write_text(file.read_text().replace(" /etc/", f" {folder}/etc/"))
    yield made
    robot.end()


def test_the_machines_are_asked_for_packages_and_units_that_exist(installed: Installed) -> None:
    units = {file.name[: -len(".service")] for file in (installed.root / "etc/systemd/system").iterdir()}
    started = [line.split(" --now ")[1].split() for line in installed.asked if " enable --now " in line]

    assert started == [
        ["robot-health-alertmanager", "robot-health-prometheus"],
        ["robot-health-alertmanager", "robot-health-victoria-metrics"],
        ["robot-health-vmalert"],
        ["robot-health-agent"],
    ]
    assert {unit for names in started for unit in names} <= units
    assert [line for line in installed.asked if "apt-get" in line] == [
        "apt-get install apache2-utils",
        "apt-get install prometheus prometheus-alertmanager",
        "apt-get install victoria-metrics",
        "apt-get install prometheus",
    ]


def test_no_other_user_can_read_the_password(installed: Installed) -> None:
    holding = [file for file in installed.root.rglob("*") if file.is_file() and is_secret(file, installed.password)]

    assert {str(file.relative_to(installed.root)) for file in holding} == {
        "out/receiver.password",
        "etc/robot-health/receiver.password",
        "etc/robot-health-centre/receiver.password",
        "etc/robot-health-centre/victoria-metrics.env",
    }
    assert [file for file in holding if file.stat().st_mode & 0o007] == []


def is_secret(file: Path, password: str) -> bool:
    return password in file.read_bytes().decode(errors="replace")


@pytest.mark.parametrize(
    ("centre", "agent"),
    [
        ("robot-health-prometheus", "robot-health-agent"),
        ("robot-health-victoria-metrics", "robot-health-vmagent"),
    ],
)
def test_what_is_installed_receives_from_a_robot_with_the_password_and_from_no_other(
    installed: Installed, centre: str, agent: str
) -> None:
    installed.start(centre)
    installed.start(agent)
    try:
        until(lambda: '"r1"' in installed.query("robots", installed.password), lambda: installed.query("robots", "x"))
        assert installed.query("robots", "wrong") == "401"
    finally:
        installed.end()


@pytest.mark.parametrize("agent", ["robot-health-agent", "robot-health-vmagent"])
@pytest.mark.parametrize("installed", ["https"], indirect=True)
def test_an_agent_gives_its_password_to_no_centre_whose_certificate_it_does_not_trust(
    installed: Installed, agent: str
) -> None:
    installed.start("robot-health-prometheus")
    installed.start(agent, trusting=False)
    try:
        log = installed.root / f"{agent}.log"
        until(lambda: "certificate signed by unknown authority" in log.read_text(), log.read_text)
    finally:
        installed.end()
