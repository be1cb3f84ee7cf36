"""A real Prometheus on loopback, which scrapes one address and ends with the test."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import time
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path
from typing import Any, Callable, Sequence, TypeVar

import pytest

from harness.reserved import free_port

PROMETHEUS = shutil.which("prometheus")

needs_prometheus = pytest.mark.skipif(PROMETHEUS is None, reason="Debian's package prometheus is not installed")

T = TypeVar("T")
_LIMIT_S = 30.0
_DIRECT = urllib.request.build_opener(urllib.request.ProxyHandler({}))


class PrometheusServer:
    """Prometheus with its data in a temporary folder."""

    def __init__(self, folder: Path, target: str, rules: str = "", authorization: str | None = None) -> None:
        """Starts it.

        Args:
            folder: for its files.
            target: `host:port` to scrape, every 0.5 s, at /metrics.
            rules: a rule file, evaluated every 0.2 s.
            authorization: bearer token to present to the target.
        """
        assert PROMETHEUS is not None
        self.port = free_port()
        self._folder = folder
        self._authorization = authorization
        (folder / "rules.yaml").write_text(rules or "groups: []")
        self._configure([target])
        self._log = open(folder / "prometheus.log", "w")  # lasts as long as the process
        self._process = subprocess.Popen(
            [
                PROMETHEUS,
                "--config.file=prometheus.yaml",
                f"--storage.tsdb.path={folder / 'data'}",
                f"--web.listen-address=127.0.0.1:{self.port}",
            ],
            cwd=folder,
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )

    def scrape(self, targets: Sequence[str]) -> None:
        """Scrapes these targets from now on, and no others."""
        self._configure(targets)
        self._process.send_signal(signal.SIGHUP)

    def _configure(self, targets: Sequence[str]) -> None:
        job: dict[str, Any] = {"job_name": "robot_health", "static_configs": [{"targets": list(targets)}]}
        if self._authorization is not None:
            job["authorization"] = {"credentials": self._authorization}
        config = {
            "global": {"scrape_interval": "500ms", "scrape_timeout": "500ms", "evaluation_interval": "200ms"},
            "rule_files": ["rules.yaml"],
            "scrape_configs": [job],
        }
        (self._folder / "prometheus.yaml").write_text(json.dumps(config))

    def query(self, expression: str) -> list[dict[str, Any]]:
        """Returns the result of an instant query: a list of `metric` and `value`."""
        address = f"http://127.0.0.1:{self.port}/api/v1/query?{urllib.parse.urlencode({'query': expression})}"
        with _DIRECT.open(address, timeout=30.0) as answer:
            result: list[dict[str, Any]] = json.load(answer)["data"]["result"]
        return result

    def wait_for(
        self, expression: str, wanted: Callable[[Sequence[dict[str, Any]]], bool] = bool
    ) -> list[dict[str, Any]]:
        """Queries until the result is as wanted; returns it."""
        end_s = time.monotonic() + _LIMIT_S
        result: Any = "no answer"
        while time.monotonic() < end_s:
            try:
                result = self.query(expression)
            except urllib.error.HTTPError as error:
                if error.code != 503:  # it is starting
                    raise AssertionError(f"{expression}: {error.read().decode()}") from None
            except OSError:
                pass
            else:
                if wanted(result):
                    return list(result)
            time.sleep(0.05)
        raise AssertionError(f"{expression}: {result}")

    def close(self) -> None:
        """Ends it."""
        self._process.kill()
        self._process.wait()
        self._log.close()
