"""A real browser that tests operate like a user: Chromium, driven by selenium; and a server for it in a thread."""

from __future__ import annotations

import asyncio
import shutil
import threading
from contextlib import contextmanager
from typing import Any, Callable, Iterator, TypeVar

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which serves the page, is not installed")
pytest.importorskip("selenium", reason="selenium, which drives the browser, is not installed")

from selenium import webdriver
from selenium.common.exceptions import (
    ElementClickInterceptedException,
    ElementNotInteractableException,
    NoSuchElementException,
    StaleElementReferenceException,
    TimeoutException,
)
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

from robot_health_monitor.rosbridge.server import Server
from robot_health_monitor.runtime.access import Access

from .web import Robots

__all__ = ["Browser", "Keys", "ServedRobots", "open_browser"]

WAIT_S = 30.0
"""Longest wait for the page, on a loaded machine."""
_OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--lang=en-US",
)

Result = TypeVar("Result")


class Browser:
    """One window."""

    def __init__(self, driver: webdriver.Chrome) -> None:
        self.driver = driver

    def open(self, url: str, width: int = 1280, *, dark: bool = False) -> None:
        """Opens an address in a window of this width, with nothing kept of earlier pages."""
        self.driver.get("about:blank")
        self.driver.execute_cdp_cmd("Network.clearBrowserCookies", {})
        self.console()
        self.resize(width, dark=dark)
        self.driver.get(url)

    def resize(self, width: int, height: int = 900, *, dark: bool = False) -> None:
        """Changes the size in CSS pixels, and the colour scheme."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})

    def run(self, script: str, *arguments: Any) -> Any:
        """Runs a script in the page and returns its result."""
        return self.driver.execute_script(script, *arguments)

    def wait_for(self, expression: str, *arguments: Any) -> Any:
        """Waits until an expression is true in the page, and returns its value.

        Raises AssertionError with what the page shows, loads and has written if it does not become true.
        """
        script = f"return ({expression})"
        wait = WebDriverWait(self.driver, WAIT_S, poll_frequency=0.05)
        try:
            return wait.until(lambda driver: driver.execute_script(script, *arguments))
        except TimeoutException:
            raise AssertionError(f"{expression}: not within {WAIT_S} s; {self._describe()}") from None

    def _describe(self) -> str:
        page = self.run("return [location.href, document.body.className, document.body.innerText]")
        files = "performance.getEntriesByType('resource')"
        loaded = self.run(f"return {files}.map((each) => [each.name, each.responseStatus, each.responseEnd])")
        return f"the page: {page!r}; loaded (name, status, ms): {loaded!r}; console: {self.console()!r}"

    def wait_for_text(self, selector: str, text: str) -> None:
        """Waits until the first element of a selector contains a text."""
        shown = "(document.querySelector(arguments[0]) || document.head).textContent.replaceAll('\u00a0', ' ')"
        self.wait_for(f"{shown}.includes(arguments[1])", selector, text)

    def find(self, selector: str) -> WebElement:
        """Returns the first element of a selector."""
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def click(self, selector: str) -> None:
        """Clicks on the first element of a selector, once it can be clicked on."""

        def click(_: object) -> bool:
            element = self.find(selector)
            element.click()
            return True

        ignored = [
            ElementClickInterceptedException,
            ElementNotInteractableException,
            NoSuchElementException,
            StaleElementReferenceException,
        ]
        WebDriverWait(self.driver, WAIT_S, 0.05, ignored).until(click)

    def type(self, selector: str, text: str) -> None:
        """Replaces the text in a field."""
        field = self.find(selector)
        field.clear()
        field.send_keys(text)

    def press(self, *keys: str) -> None:
        """Presses keys, wherever the focus is."""
        for key in keys:
            self.driver.switch_to.active_element.send_keys(key)

    def texts(self, selector: str) -> list[str]:
        """Returns the texts of all elements of a selector, with blanks in place of no-break spaces."""
        found: list[str] = self.run(
            "return [...document.querySelectorAll(arguments[0])].map((each) => each.textContent)"
            ".map((text) => text.replaceAll('\u00a0', ' '))",
            selector,
        )
        return found

    def console(self) -> list[str]:
        """Returns what the page has written to the console since the last call, without advice."""
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]


@contextmanager
def open_browser(*further_options: str) -> Iterator[Browser]:
    """Starts a browser; skips the test where none is installed."""
    programs = {name: shutil.which(name) for name in ("chromium", "chromedriver")}
    missing = [name for name, path in programs.items() if path is None]
    if missing:
        pytest.skip(f"no {' and no '.join(missing)}: as root, apt-get install chromium chromium-driver")
    options = Options()
    options.binary_location = str(programs["chromium"])
    for option in (*_OPTIONS, *further_options):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(programs["chromedriver"]))
    try:
        yield Browser(driver)
    finally:
        driver.quit()


class ServedRobots:
    """Robots behind a real server, in the thread of its loop."""

    def __init__(self, robots: Robots, *, token: str = "", port: int = 0) -> None:
        """Starts the server; `close` ends it."""
        self.robots = robots
        self._token = token
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="served robots", daemon=True)
        self._thread.start()
        self._server = self._run(self._start(port))
        self.url = f"http://127.0.0.1:{self._server.port}/"

    async def _start(self, port: int) -> Server:
        robots = self.robots
        web = self._web = robots.interface()
        access = Access(services=("/alert_system/re*",), token=self._token)
        node = robots.bus.node("server")
        server = Server(node, port=port, access=access, threads=False, routes=web.routes, on_close=web.close)
        await server.start()
        return server

    def _run(self, coroutine: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(WAIT_S)

    def do(self, action: Callable[[Robots], Result]) -> Result:
        """Does something with the robots in the thread of the server, and returns its result."""

        async def act() -> Result:
            return action(self.robots)

        result: Result = self._run(act())
        return result

    @property
    def pages(self) -> int:
        """Number of open pages."""
        return len(self._web.updates.pages)

    def observe(self, value: object, signal: str = "battery_level", robot: int = 0, after_s: float = 1.0) -> None:
        """Lets time pass, then a sample come."""

        self.pass_time(after_s)
        self.do(lambda robots: robots.observe(value, signal, robot))

    def pass_time(self, seconds: float) -> None:
        """Lets time pass in steps of at most 1 s: after longer ones, the monitor would report late ticks."""

        def act(robots: Robots) -> None:
            end_s = robots.bus.now_s + seconds
            while robots.bus.now_s < end_s:
                robots.at(min(end_s, robots.bus.now_s + 1.0))

        self.do(act)

    def close(self) -> None:
        """Ends the server and its connections. May be called twice."""
        if self._loop.is_closed():
            return
        self._run(self._server.close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(WAIT_S)
        self._loop.close()
        if self.robots.history is not None:
            self.robots.history.close()
