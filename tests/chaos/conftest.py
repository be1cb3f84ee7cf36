"""Starts monitors and robots, and ends them after the test."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any, Callable, Iterator, Sequence

import pytest
from harness.chaos import PEERS, THRESHOLDS, Robot
from harness.line_process import LineProcess
from harness.reserved import free_port
from harness.seeds import new_seed
from harness.separate_network import SeparateNetwork
from harness.warm_python import start_fork

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def seed() -> int:
    return new_seed()


@pytest.fixture
def environment() -> dict[str, str]:
    variables = {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8", "PYTHONUNBUFFERED": "1"}
    return {**os.environ, **variables, "SSL_CERT_FILE": os.devnull}  # without the public authorities it starts sooner


@pytest.fixture
def thresholds(tmp_path: Path) -> Path:
    file = tmp_path / "thresholds.yaml"
    file.write_text(THRESHOLDS)
    return file


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def robot_health(environment: dict[str, str]) -> Iterator[Callable[..., LineProcess]]:
    started: list[LineProcess] = []

    def start(*arguments: object) -> LineProcess:
        command = [sys.executable, "-m", "robot_health_monitor", *map(str, arguments)]
        started.append(LineProcess(command, environment, start=start_fork))
        return started[-1]

    yield start
    for process in started:
        process.end()


@pytest.fixture
def robot(environment: dict[str, str]) -> Iterator[Callable[..., Robot]]:
    """Starts a robot: (name of the peer, its arguments, words before the command, variables)."""
    started: list[Any] = []

    def start(peer: str, *arguments: object, prefix: Sequence[str] = (), **variables: str) -> Robot:
        command = [*prefix, sys.executable, str(PEERS / f"{peer}.py"), *map(str, arguments)]
        started.append(Robot(command, {**environment, **variables}))
        return started[-1]

    yield start
    for each in started:
        each.end()


@pytest.fixture
def network() -> Iterator[SeparateNetwork]:
    """A network between this machine and the robot, which can be cut."""
    network = SeparateNetwork()
    yield network
    network.close()
