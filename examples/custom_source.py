"""A source of samples that the monitor does not have: how full a disk is.

    python examples/custom_source.py --duration 10 --warn-above 90 /

Anything that returns a number can be watched like this: a CAN bus, a web API, a serial port.
"""

import argparse
import shutil
import time

from robot_health_monitor.core import ConfigError, Monitor, Sample, load_config

PERIOD_S = 0.5


def used_percent(path: str) -> float:
    """Returns how full the file system of `path` is, in percent."""
    usage = shutil.disk_usage(path)
    return 100.0 * usage.used / usage.total


def main() -> None:
    """Measures, judges and prints until the time is up."""
    parser = argparse.ArgumentParser(description="Watches how full a disk is.")
    parser.add_argument("path", nargs="?", default="/", help="a file or folder on the disk (default: /)")
    parser.add_argument("--warn-above", type=float, default=90.0, metavar="PERCENT")
    parser.add_argument("--duration", type=float, default=10.0, metavar="S")
    options = parser.parse_args()

    signal = {"unit": "%", "warn_above": options.warn_above, "hysteresis": 1.0, "stale_after_s": 3 * PERIOD_S}
    try:
        monitor = Monitor(load_config({"signals": {"disk_usage": signal}}))
    except ConfigError as error:  # one line that names the key, such as a bound of 101 %
        parser.error(str(error))

    end_s = time.monotonic() + options.duration
    while time.monotonic() < end_s:
        now_s = time.monotonic()  # not time.time(), which jumps when the clock is set
        try:
            changes = monitor.observe(Sample("disk_usage", used_percent(options.path), now_s))
        except OSError:
            changes = monitor.tick(now_s)  # without samples the signal becomes STALE by itself
        for transition in changes:
            print(transition.text)
        time.sleep(PERIOD_S)

    print(monitor.report(time.monotonic()).statuses["disk_usage"].message)


if __name__ == "__main__":
    main()
