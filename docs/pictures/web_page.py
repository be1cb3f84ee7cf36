"""Makes the pictures of the web page from real runs in chromium; make.py calls it. Needs selenium."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Iterator

from harness.reserved import free_port
from harness.waiting import wait_for
from past import write_yesterday
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service

PACKAGE = "robot_health_monitor"
_THRESHOLDS = """\
alert_system:
  ros__parameters:
    signals:
      battery_level: {unit: "%", warn_below: 20.0, error_below: 10.0, hysteresis: 2.0}
      temperature: {unit: "degC", warn_above: 40.0, error_above: 50.0, hysteresis: 2.0}
      cpu_usage: {unit: "%", warn_above: 95.0}
"""
_FORECAST = """\
      battery_soon:
        {topic: battery_level, unit: "%", statistic: forecast, forecast_s: 60.0, window_s: 30.0, warn_below: 20.0}
"""
_BATTERY = "[...document.querySelectorAll('.signal-name')].find((e) => e.textContent === 'battery_level')"


def one_robot(folder: Path, variables: dict[str, str], pictures: Path) -> None:
    """`robot-health run` with a forecast, after the first alert, and the plot of a day."""
    history = folder / "history.db"
    write_yesterday(history, ["robot1"])
    (folder / "ops.yaml").write_text(f"history: {{file: {history}}}\n", encoding="utf-8")
    (folder / "one.yaml").write_text(
        _THRESHOLDS.replace("40.0", "80.0").replace("50.0", "95.0") + _FORECAST, encoding="utf-8"
    )
    port = free_port()
    arguments = ["run", "--robot", "robot1", "--port", str(port), "--thresholds", str(folder / "one.yaml")]
    arguments += ["--ops", str(folder / "ops.yaml")]
    with _programs([arguments], variables), _browser(1000, 880) as driver:
        _open(driver, port)
        _wait(driver, "document.querySelector('.robot.warn')", 130.0)
        _open_signal(driver, "battery_soon")
        _wait(driver, "document.querySelector('.plot .ahead') && document.querySelector('.signals .alert')")
        _resize(driver, 1000, 700)
        driver.save_screenshot(str(pictures / "forecast.png"))
        _open_signal(driver, "battery_soon")
        _resize(driver, 1000, 880)
        _wait(driver, f"{_BATTERY}.closest('tbody, tr').matches('.warn')", 130.0)
        _open_signal(driver, "battery_level")
        _wait(driver, "document.querySelector('.plot svg') && document.querySelector('.signals .alert')")
        time.sleep(6.0)  # a part of the plot is below the bound
        driver.save_screenshot(str(pictures / "web_page.png"))
        _run(
            driver, "[...document.querySelectorAll('.ranges button')].find((e) => e.textContent === '24 hours').click()"
        )
        _wait(driver, "document.querySelector('.plot').plot.signal.steps.length > 200")
        time.sleep(1.0)
        driver.save_screenshot(str(pictures / "web_page_day.png"))


def fleet(folder: Path, variables: dict[str, str], picture: Path, phone: Path) -> None:
    """`robot-health connect` to seven robots, of which one is hot, one sends nothing and one is gone."""
    (folder / "hot.yaml").write_text(_THRESHOLDS, encoding="utf-8")
    names = ["husky1", "husky2", "jackal", "carter", "ridgeback", "dingo", "boxer"]
    ports = {name: free_port() for name in names}
    lines = ["robots:"]
    for name, port in ports.items():
        thresholds = f", thresholds: {folder / 'hot.yaml'}" if name == "carter" else ""
        lines.append(f"  {name}: {{url: ws://127.0.0.1:{port}{thresholds}}}")
    history = folder / "fleet.db"
    write_yesterday(history, names)
    (folder / "fleet_ops.yaml").write_text(f"history: {{file: {history}}}\n", encoding="utf-8")
    (folder / "fleet.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    starts = [["run", "--robot", name, "--port", str(port)] for name, port in ports.items()]
    starts[1] += ["--source", "none"]
    port = free_port()
    watch = ["connect", "--fleet", str(folder / "fleet.yaml"), "--port", str(port)]
    watch += ["--ops", str(folder / "fleet_ops.yaml")]
    with _programs([starts[0]], variables), _browser(1000, 560) as driver:
        time.sleep(40.0)  # its battery is empty before that of the others
        with _programs([*starts[1:2], *starts[3:], watch], variables):
            with _programs([starts[2]], variables):
                _open(driver, port)
                _wait(driver, "document.querySelectorAll('.robot').length === 7")
                _wait(driver, "document.querySelectorAll('.robot.ok').length >= 4", 60.0)
            for kind in ("nolink", "stale", "warn", "error"):
                _wait(driver, f"document.querySelector('.robot.{kind}')", 130.0)
            driver.save_screenshot(str(picture))
            _resize(driver, 390, 760)
            driver.save_screenshot(str(phone))


@contextmanager
def _programs(commands: list[list[str]], variables: dict[str, str]) -> Iterator[None]:
    with ExitStack() as stack:
        for command in commands:
            silent = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
            program = subprocess.Popen([sys.executable, "-m", PACKAGE, *command], env=variables, **silent)
            stack.callback(program.wait, 20.0)
            stack.callback(program.terminate)
        yield


@contextmanager
def _browser(width: int, height: int) -> Iterator[webdriver.Chrome]:
    options = Options()
    for option in ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"):
        options.add_argument(option)
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    try:
        _resize(driver, width, height)
        yield driver
    finally:
        driver.quit()


def _resize(driver: webdriver.Chrome, width: int, height: int) -> None:
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def _open(driver: webdriver.Chrome, port: int) -> None:
    wait_for(lambda: socket.socket().connect_ex(("127.0.0.1", port)) == 0, 60.0)
    driver.get(f"http://127.0.0.1:{port}/")


def _open_signal(driver: webdriver.Chrome, name: str) -> None:
    _run(driver, f"[...document.querySelectorAll('.signal-name')].find((e) => e.textContent === '{name}').click()")


def _run(driver: webdriver.Chrome, script: str) -> object:
    return driver.execute_script(script)


def _wait(driver: webdriver.Chrome, expression: str, seconds: float = 30.0) -> None:
    wait_for(lambda: bool(_run(driver, f"return Boolean({expression})")), seconds)
