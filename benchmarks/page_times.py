"""How long a person waits for the page, in chromium: 200 robots, with thirty days of samples behind each."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

from benchmarks.long_past import DAYS, write_past
from benchmarks.peer import Peer
from benchmarks.table import Row

ROBOTS, SIGNALS = 200, 10
ROUNDS = 5
SIGHT_LIMIT_MS, RANGE_LIMIT_MS = 1000.0, 500.0
WAIT_S = 30.0
# Both end with the second frame after the change: then it is on the screen.
_FIRST_SIGHT = """
(() => {
  const painted = (action) => requestAnimationFrame(() => requestAnimationFrame(action));
  const look = () => {
    const robots = document.querySelectorAll(".robot").length, bars = document.querySelectorAll(".day .cell").length;
    if (robots >= %d && !isSeen) painted(() => { window.rowsMs = performance.now(); });
    isSeen = isSeen || robots >= %d;
    if (isSeen && bars > robots) painted(() => { window.barsMs = performance.now(); });
    else requestAnimationFrame(look);
  };
  let isSeen = false;
  requestAnimationFrame(look);
})();
"""
_CHANGE_RANGE = """
const [name, done] = arguments, {plot} = document.querySelector(".plot"), before = plot.signal;
const begin = performance.now();
const painted = (action) => requestAnimationFrame(() => requestAnimationFrame(action));
const width = {"1 hour": 10, "24 hours": 120, "7 days": 900, "30 days": 3600}[name];
const look = () => {
  const isNew = plot.signal !== before && plot.signal.width === width && plot.signal.steps.length > 50;
  if (isNew) painted(() => done(performance.now() - begin));
  else requestAnimationFrame(look);
};
[...document.querySelectorAll(".ranges button")].find((each) => each.textContent === name).click();
look();
"""
RANGES = ("30 days", "7 days", "24 hours", "1 hour")


def rows() -> Iterator[Row]:
    """Measures and yields the rows of the table; without a browser, one row that says so."""
    try:
        yield from _measure()
    except (ImportError, OSError, RuntimeError) as problem:
        yield Row(f"web, the page of {ROBOTS} robots in chromium", "", remark=str(problem))


def _measure() -> Iterator[Row]:
    with contextlib.ExitStack() as running:
        driver = _browser(running)
        file = Path(running.enter_context(tempfile.TemporaryDirectory()), "history.db")
        write_past(file, [f"robot{number}" for number in range(ROBOTS)], "signal_0", time.time())
        server = Peer("web_peers", "monitor", ROBOTS, SIGNALS, 1.0, file)
        running.callback(server.end)
        url = f"http://127.0.0.1:{server.first}/"
        sight_ms = [_first_sight(driver, url) for _ in range(ROUNDS + 1)][1:]  # the first one starts the browser
        taken_ms = _range_changes(driver)
    what = f"web, {ROBOTS} robots with {SIGNALS} signals at 1 Hz, {DAYS:g} days of samples"
    # The fastest is what it takes when the machine does nothing else.
    for name, times_ms in zip(("first sight", "with the bars of 24 hours"), zip(*sight_ms)):
        took = min(times_ms)
        remark = f"from address to all rows, fastest of {ROUNDS}, to {SIGHT_LIMIT_MS:g} ms"
        yield Row(what, f"page, {name}", f"{took:.0f} ms", took / SIGHT_LIMIT_MS, 1.0, remark)
    for name, times_ms in taken_ms.items():
        took = min(times_ms)
        remark = f"from click to plot, fastest of {ROUNDS}, to {RANGE_LIMIT_MS:g} ms"
        yield Row(what, f"page, range of {name}", f"{took:.0f} ms", took / RANGE_LIMIT_MS, 1.0, remark)


def _browser(running: contextlib.ExitStack) -> Any:
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    chromedriver = shutil.which("chromedriver")
    if chromedriver is None:
        raise RuntimeError("chromedriver is not installed")
    options = Options()
    for option in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-background-networking"):
        options.add_argument(option)
    driver = webdriver.Chrome(options=options, service=Service(chromedriver))
    running.callback(driver.quit)
    driver.set_script_timeout(WAIT_S)
    driver.set_window_size(1280, 900)
    driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": _FIRST_SIGHT % (ROBOTS, ROBOTS)})
    return driver


def _first_sight(driver: Any, url: str) -> Tuple[float, float]:
    driver.get("about:blank")
    driver.execute_cdp_cmd("Network.clearBrowserCache", {})
    driver.get(url)
    bars_ms = float(_wait(driver, "window.barsMs"))
    return float(_wait(driver, "window.rowsMs")), bars_ms


def _range_changes(driver: Any) -> Dict[str, List[float]]:
    driver.execute_script("document.querySelector('.robot-head').click()")
    _wait(driver, "document.querySelector('.signal-name')")
    driver.execute_script(
        "[...document.querySelectorAll('.signal-name')].find((each) => each.textContent === 'signal_0').click()"
    )
    _wait(driver, "document.querySelector('.plot svg')")
    taken: Dict[str, List[float]] = {name: [] for name in RANGES}
    for _ in range(ROUNDS):
        for name, times_ms in taken.items():
            times_ms.append(float(driver.execute_async_script(_CHANGE_RANGE, name)))
    return taken


def _wait(driver: Any, expression: str) -> Any:
    end_s = time.monotonic() + WAIT_S
    while not (value := driver.execute_script(f"return ({expression}) || null")):
        if time.monotonic() > end_s:
            raise RuntimeError(f"the page did not show {expression} within {WAIT_S:g} s")
        time.sleep(0.05)
    return value
