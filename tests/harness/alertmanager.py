"""A real Alertmanager on a free port of 127.0.0.1; Debian's package prometheus-alertmanager."""

from __future__ import annotations

import json
import shutil
import subprocess
import time
import urllib.request
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Iterator

import pytest

from harness.reserved import free_port

EXECUTABLE = shutil.which("prometheus-alertmanager") or shutil.which("alertmanager")

needs_alertmanager = pytest.mark.skipif(
    EXECUTABLE is None, reason="no Alertmanager: as root, apt-get install prometheus-alertmanager"
)

DEADLINE_S = 30.0


class RunningAlertmanager:
    """Its address, and its alerts as its API returns them."""

    def __init__(self, url: str) -> None:
        self.url = url

    def alerts(self) -> list[dict[str, Any]]:
        """Returns the alerts that are firing."""
        found: list[dict[str, Any]] = json.loads(self._get("/api/v2/alerts"))
        return found

    def levels(self) -> dict[str, str]:
        """Returns the level of each signal with an alert that is firing; fails if a signal has several."""
        alerts = self.alerts()
        levels = {alert["labels"]["signal"]: alert["labels"]["level"] for alert in alerts}
        assert len(levels) == len(alerts), alerts
        return levels

    def _get(self, path: str) -> bytes:
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(self.url + path, timeout=DEADLINE_S) as response:
            body: bytes = response.read()
        return body

    def wait_until_ready(self, process: subprocess.Popen[bytes]) -> None:
        until_s = time.monotonic() + DEADLINE_S
        while True:
            try:
                self._get("/-/ready")
                return
            except OSError:
                assert process.poll() is None and time.monotonic() < until_s, "Alertmanager does not start"
                time.sleep(0.02)


@contextmanager
def running_alertmanager(folder: Path, webhook: str = "") -> Iterator[RunningAlertmanager]:
    """Runs Alertmanager with its data in `folder`; it notifies the address of a webhook, if there is one."""
    assert EXECUTABLE is not None
    webhooks = [{"url": webhook}] if webhook else []
    config = {"route": {"receiver": "one"}, "receivers": [{"name": "one", "webhook_configs": webhooks}]}
    (folder / "alertmanager.yml").write_text(json.dumps(config))
    address = f"127.0.0.1:{free_port()}"
    process = subprocess.Popen(
        [
            EXECUTABLE,
            f"--config.file={folder / 'alertmanager.yml'}",
            f"--storage.path={folder / 'data'}",
            f"--web.listen-address={address}",
            "--cluster.listen-address=",
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        alertmanager = RunningAlertmanager(f"http://{address}")
        alertmanager.wait_until_ready(process)
        yield alertmanager
    finally:
        process.kill()
        process.wait()
