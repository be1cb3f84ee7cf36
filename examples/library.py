"""The monitor as a library: judges numbers from any origin, without ROS.

    pip install .
    python examples/library.py

Prints three alert lines: the battery is low, then its sensor is silent, then all is well again.
"""

from robot_health_monitor.core import Monitor, Sample, load_config

# The same keys as in thresholds.yaml; load_config also takes the path of such a file.
CONFIG = {
    "signals": {
        "battery_level": {
            "unit": "%",
            "warn_below": 20.0,
            "for_s": 3.0,  # a dip that is shorter is no alert
            "stale_after_s": 5.0,  # silence that is longer is an alert
        }
    }
}


def main() -> None:
    """Judges a minute of a robot's life in a few milliseconds: the caller supplies the time."""
    monitor = Monitor(load_config(CONFIG))
    # The battery is swapped between 20 s and 40 s; the robot is off.
    battery_percent = {second: 30.0 - second for second in range(20)}
    battery_percent.update(dict.fromkeys(range(40, 60), 100.0))

    for second in range(60):
        now_s = float(second)
        if second in battery_percent:
            for transition in monitor.observe(Sample("battery_level", battery_percent[second], now_s)):
                print(transition)
        # Time alone can change a level too: call tick regularly.
        for transition in monitor.tick(now_s):
            print(transition)

    for name, status in monitor.report(60.0).statuses.items():
        print(f"in the end: {name} is {status.level.name}, {status.message}")


if __name__ == "__main__":
    main()
