"""A fleet whose robots push, on loopback: the files of `robot-health export fleet`, run by the commands in their units.

Only folders, ports and the pager are replaced. A `Scraped` stands between a monitor and its agent: it keeps how many
series the agent was given, which is what the centre must have in the end.
"""

from __future__ import annotations

import base64
import contextlib
import json
import re
import select
import shlex
import socket
import subprocess
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, Sequence

from robot_health_monitor.core.config.monitor_config import MonitorConfig
from robot_health_monitor.ops.export.fleet import FleetSettings, export_fleet

CENTRE_FOLDER, ROBOT_FOLDER = "/etc/robot-health-centre", "/etc/robot-health"
PASSWORD = "s3cret"
_HASH = "$2b$04$1s.ywpeSchEHw0KxicqH0uBbeaDE2H7x16IkU1PS3YeU1/dHGPLPu"  # bcrypt of PASSWORD
_LIMIT_S = 60.0
_SLOW_S = 0.5
_DIRECT = urllib.request.build_opener(urllib.request.ProxyHandler({}))


def get(url: str) -> bytes:
    """Returns the answer of a server on this machine, which may require the password."""
    request = urllib.request.Request(url)
    credentials = base64.b64encode(f"robots:{PASSWORD}".encode()).decode()
    request.add_header("Authorization", f"Basic {credentials}")
    with _DIRECT.open(request, timeout=_LIMIT_S) as answer:
        body: bytes = answer.read()
    return body


def has_read_all(connection: socket.socket) -> bool:
    """Returns whether the client has read the answer: if it gave up before, its kernel has reset the connection."""
    connection.settimeout(_LIMIT_S)
    connection.shutdown(socket.SHUT_WR)
    try:
        return connection.recv(1) == b"" and connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == 0
    except OSError:
        return False


class Scraped:
    """Serves an exposition, and keeps how many series of each name an agent has read to the end."""

    def __init__(self, exposition: Callable[[], bytes]) -> None:
        """Serves what `exposition` returns; it is called in several threads."""
        self.series: dict[str, int] = {}
        self.exposition = exposition
        """Call it to ask without being counted."""
        self._lock = threading.Lock()
        self._stopped = False
        owner = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                began_s = time.monotonic()
                try:
                    body = b"" if owner._stopped else exposition()
                except OSError:
                    body = None
                if body is None or time.monotonic() - began_s > _SLOW_S:
                    self.send_error(503)  # an agent that no longer waits would not have what is counted
                    return
                with contextlib.suppress(OSError):
                    if select.select([self.connection], [], [], 0.0)[0]:
                        return  # it has closed the connection
                    self.send_response(200)
                    self.send_header("Content-Type", "text/plain; version=0.0.4")
                    self.send_header("Content-Length", str(len(body)))
                    self.end_headers()
                    self.wfile.write(body)
                    if has_read_all(self.connection):
                        owner._note(body)

            def log_message(self, *arguments: object) -> None:
                """Writes nothing."""

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"127.0.0.1:{self._server.server_address[1]}"
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()

    def _note(self, body: bytes) -> None:
        with self._lock:
            for line in body.decode().splitlines():
                if line and not line.startswith("#"):
                    name = re.split(r"[{ ]", line, maxsplit=1)[0]
                    self.series[name] = self.series.get(name, 0) + 1

    def stop(self) -> None:
        """Serves no series from now on."""
        self._stopped = True

    def end(self) -> None:
        """Closes it."""
        self._server.shutdown()
        self._server.server_close()


class Pager:
    """Receives what Alertmanager sends, and counts the notifications of each alert."""

    def __init__(self) -> None:
        """Listens on a free port."""
        self.sent: list[dict[str, Any]] = []
        owner = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                owner.sent.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
                self.send_response(200)
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *arguments: object) -> None:
                """Writes nothing."""

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/"
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()

    def end(self) -> None:
        """Closes it."""
        self._server.shutdown()
        self._server.server_close()


class PushingFleet:
    """The processes of a centre and of agents, in a folder."""

    def __init__(
        self,
        folder: Path,
        config: MonitorConfig,
        free_port: Callable[[], int],
        *,
        robots: Sequence[str] | None = None,
        interval_s: float = 1.0,
        silent_after_s: float = 900.0,
        outage_s: float = 6 * 3600.0,
        group_interval: str = "1s",
    ) -> None:
        """Starts nothing yet; Alertmanager notifies of changes after `group_interval`."""
        self._group_interval = group_interval
        self._folder = folder
        self._free_port = free_port
        self._config = config
        self._robots = robots
        self._settings = FleetSettings("", outage_s, interval_s, silent_after_s)
        self.port = free_port()
        self.alertmanager_port = free_port()
        self.pager = Pager()
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._centre = self._written("centre", [], self.port)

    def _written(self, name: str, monitors: Sequence[str], port: int) -> dict[str, str]:
        """Writes the files of an export to a folder of its own; returns them with the folders and ports of this run."""
        settings = self._settings._replace(receiver=f"http://127.0.0.1:{port}/api/v1/write", monitors=monitors)
        exported = export_fleet(settings, self._config, self._robots)
        folder = self._folder / name
        replaced = {
            CENTRE_FOLDER: str(folder),
            ROBOT_FOLDER: str(folder),
            "/var/lib/": f"{folder}/state-",
            "127.0.0.1:9093": f"127.0.0.1:{self.alertmanager_port}",
            "127.0.0.1:9095": f"127.0.0.1:{self._free_port()}",
            "127.0.0.1:8429": f"127.0.0.1:{self._free_port()}",
            "127.0.0.1:8880": f"127.0.0.1:{self._free_port()}",
            f"address=:{port} ": f"address=127.0.0.1:{port} ",
            f"Addr=:{port} ": f"Addr=127.0.0.1:{port} ",
        }
        folder.mkdir(exist_ok=True)
        files: dict[str, str] = {}
        for path, text in exported.items():
            for old, new in replaced.items():
                text = text.replace(old, new)
            files[Path(path).name] = text
        notified = f"    webhook_configs: [{{url: {self.pager.url}, send_resolved: true}}]"
        pager = re.sub(r"    pagerduty_configs:\n.*", notified, files["alertmanager.yml"])
        files["alertmanager.yml"] = pager.replace("group_wait: 30s", "group_wait: 1s").replace(
            "group_interval: 5m", f"group_interval: {self._group_interval}"
        )
        files["receiver.password"] = PASSWORD
        files["web.yml"] = f'basic_auth_users: {{robots: "{_HASH}"}}\n'
        for path, text in files.items():
            (folder / path).write_text(text)
        return files

    def start(self, unit: str, files: dict[str, str] | None = None, name: str = "centre") -> None:
        """Starts the command of a unit, by default of the centre."""
        command = re.search(r"ExecStart=((?:.|\\\n)*?)\nExec", (files or self._centre)[f"robot-health-{unit}.service"])
        assert command is not None
        log = (self._folder / f"{name}-{unit}.log").open("ab")
        password = {"httpAuth_username": "robots", "httpAuth_password": PASSWORD}
        words = shlex.split(command[1].replace("\\\n", " "))
        self.processes[f"{name} {unit}"] = subprocess.Popen(words, stdout=log, stderr=log, env=password)
        log.close()

    def start_agent(self, name: str, monitors: Sequence[str], *, unit: str = "agent", port: int = 0) -> None:
        """Starts an agent that scrapes these addresses and pushes to the centre, or to another port."""
        self.start(unit, self._written(name, monitors, port or self.port), name)

    def kill(self, process: str) -> None:
        """Kills a process, as if the power went."""
        ended = self.processes.pop(process)
        ended.kill()
        ended.wait()

    def stop(self, process: str) -> None:
        """Ends a process as systemd does."""
        ended = self.processes.pop(process)
        ended.terminate()
        ended.wait(_LIMIT_S)

    def query(self, expression: str) -> list[dict[str, Any]]:
        """Returns the result of an instant query: a list of `metric` and `value`."""
        words = urllib.parse.urlencode({"query": expression, "nocache": 1})
        result: list[dict[str, Any]] = json.loads(get(f"http://127.0.0.1:{self.port}/api/v1/query?{words}"))["data"][
            "result"
        ]
        return result

    def by_label(self, expression: str, *labels: str) -> dict[Any, float]:
        """Returns the values of an instant query by labels; without a centre that answers, none."""
        try:
            found = self.query(expression)
        except urllib.error.HTTPError as error:
            if error.code != 503:
                raise
            return {}  # it is starting
        except OSError:
            return {}
        return {tuple(each["metric"].get(label, "") for label in labels): float(each["value"][1]) for each in found}

    def counts(self, names: Iterable[str], window_s: float = 900.0) -> dict[str, float]:
        """Returns how many samples of each metric the centre has.

        It counts half of the robots at a time: VictoriaMetrics refuses a query of too many series.
        """
        found: dict[str, float] = {}
        for name in names:
            for half in ('robot=~".*[0-4]"', 'robot!~".*[0-4]"'):
                series = f"{name}{{{half}}}"
                for count in self.by_label(f"sum(count_over_time({series}[{window_s:.0f}s]))").values():
                    found[name] = found.get(name, 0.0) + count
        return found

    def end(self) -> None:
        """Kills every process."""
        for process in list(self.processes):
            self.kill(process)
        self.pager.end()


@contextlib.contextmanager
def pushing_fleet(*arguments: Any, **options: Any) -> Iterator[PushingFleet]:
    """Runs a fleet, and ends it."""
    fleet = PushingFleet(*arguments, **options)
    try:
        yield fleet
    finally:
        fleet.end()


def until(condition: Callable[[], object], seen: Callable[[], object] = str, limit_s: float = _LIMIT_S) -> None:
    """Waits for a condition of other processes; AssertionError: it does not hold in time, and what was seen."""
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s, f"still not true after {limit_s:g} s: {seen()}"
        time.sleep(0.1)
