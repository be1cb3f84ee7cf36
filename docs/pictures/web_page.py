"""Makes the pictures of the web page from real runs in chromium; make.py calls it. Needs selenium."""

from __future__ import annotations

import json
import socket
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Iterator, Mapping

from harness.driven_browser import Browser, open_browser
from harness.line_process import LineProcess
from harness.reserved import free_port
from harness.waiting import wait_for
from past import write_yesterday

HERE = Path(__file__).resolve().parent
PACKAGE = "robot_health_monitor"


def one_robot(folder: Path, variables: Mapping[str, str]) -> None:
    """`robot-health run` with a forecast, after the first alert, and the plot of a day."""
    port = free_port()
    command = ["run", "--robot", "robot1", "--port", str(port), "--thresholds", str(HERE / "forecast.yaml")]
    command += _with_yesterday(folder, ["robot1"])
    with _programs([command], variables), _window(port, 1000, 880) as browser:
        _wait(browser, "document.querySelector('.robot.warn')", 130.0)
        _open_signal(browser, "battery_soon")
        _wait(browser, "document.querySelector('.plot .ahead') && document.querySelector('.signals .alert')")
        browser.resize(1000, 700)
        _save(browser, "forecast")
        _open_signal(browser, "battery_soon")
        browser.resize(1000, 880)
        _wait(browser, f"{_element('.signal-name', 'battery_level')}.closest('tbody, tr').matches('.warn')", 130.0)
        _open_signal(browser, "battery_level")
        _wait(browser, "document.querySelector('.plot svg') && document.querySelector('.signals .alert')")
        time.sleep(6.0)  # a part of the plot is below the bound
        _save(browser, "web_page")
        browser.run(f"{_element('.ranges button', '24 hours')}.click()")
        _wait(browser, "document.querySelector('.plot').plot.signal.steps.length > 200")
        time.sleep(1.0)
        _save(browser, "web_page_day")


def fleet(folder: Path, variables: Mapping[str, str]) -> None:
    """`robot-health connect` to seven robots, of which one is hot, one sends nothing and one is gone."""
    names = ["husky1", "husky2", "jackal", "carter", "ridgeback", "dingo", "boxer"]
    ports = {name: free_port() for name in names}
    robots = {name: {"url": f"ws://127.0.0.1:{port}"} for name, port in ports.items()}
    robots["carter"]["thresholds"] = str(HERE / "hot.yaml")
    (folder / "fleet.yaml").write_text(json.dumps({"robots": robots}), encoding="utf-8")
    starts = [["run", "--robot", name, "--port", str(port)] for name, port in ports.items()]
    starts[1] += ["--source", "none"]
    port = free_port()
    watch = ["connect", "--fleet", str(folder / "fleet.yaml"), "--port", str(port), *_with_yesterday(folder, names)]
    with _programs([starts[0]], variables):
        time.sleep(40.0)  # its battery is empty before that of the others
        with _programs([*starts[1:2], *starts[3:], watch], variables), ExitStack() as stack:
            with _programs([starts[2]], variables):
                browser = stack.enter_context(_window(port, 1000, 560))
                _wait(browser, "document.querySelectorAll('.robot').length === 7")
                _wait(browser, "document.querySelectorAll('.robot.ok').length >= 4", 60.0)
            for kind in ("nolink", "stale", "warn", "error"):
                _wait(browser, f"document.querySelector('.robot.{kind}')", 130.0)
            _save(browser, "fleet")
            browser.resize(390, 760)
            _save(browser, "fleet_phone")


def report(page: Path) -> None:
    """The report of a replay."""
    with open_browser("--hide-scrollbars") as browser:
        browser.resize(1100, 1250)
        browser.driver.get(page.as_uri())
        _save(browser, "report")


def _with_yesterday(folder: Path, robots: list[str]) -> list[str]:
    """Returns the option for an ops.yaml whose history has the last 24 hours of the robots."""
    history, ops = folder / f"{len(robots)}.db", folder / f"{len(robots)}_ops.yaml"
    write_yesterday(history, robots)
    ops.write_text(f"history: {{file: {history}}}\n", encoding="utf-8")
    return ["--ops", str(ops)]


@contextmanager
def _programs(commands: list[list[str]], variables: Mapping[str, str]) -> Iterator[None]:
    with ExitStack() as stack:
        for command in commands:
            stack.callback(LineProcess([sys.executable, "-m", PACKAGE, *command], variables).end)
        yield


@contextmanager
def _window(port: int, width: int, height: int) -> Iterator[Browser]:
    """Opens the page of a monitor as soon as it is served."""
    wait_for(lambda: socket.socket().connect_ex(("127.0.0.1", port)) == 0, 60.0)
    with open_browser("--hide-scrollbars") as browser:
        browser.resize(width, height)
        browser.driver.get(f"http://127.0.0.1:{port}/")
        yield browser


def _element(selector: str, text: str) -> str:
    return f"[...document.querySelectorAll('{selector}')].find((each) => each.textContent === '{text}')"


def _open_signal(browser: Browser, name: str) -> None:
    browser.run(f"{_element('.signal-name', name)}.click()")


def _wait(browser: Browser, expression: str, seconds: float = 30.0) -> None:
    wait_for(lambda: browser.run(f"return Boolean({expression})"), seconds)


def _save(browser: Browser, name: str) -> None:
    browser.driver.save_screenshot(str(HERE / f"{name}.png"))
