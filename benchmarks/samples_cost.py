"""CPU time of storing samples: 200 robots with ten signals each, at 1 Hz.

The monitors take the same samples in virtual time, once with `samples` in the history and once without; alerts are
stored in both cases. The figure is what the samples add: collecting, taking, and writing them to the file.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from contextlib import closing
from pathlib import Path
from typing import Iterator

from benchmarks.table import Row
from robot_health_monitor.core import Monitor, Sample, load_config
from robot_health_monitor.core.judge.continuity import Continuity
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History

ROBOTS = 200
SIGNALS = tuple(f"signal_{number}" for number in range(10))
SECONDS = 120
ROUNDS = 5
AT_MOST_PERCENT = 1.0

_BEGIN_S = 1.8e9
_PATIENCE_S = 100.0


def rows(rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    pairs = [(percent_of_core(samples=False), percent_of_core(samples=True)) for _ in range(rounds)]
    without = statistics.median(one for one, _ in pairs)
    added = statistics.median(other - one for one, other in pairs)
    what = f"{ROBOTS} robots, {len(SIGNALS)} signals each at 1 Hz"
    yield Row(what, "without samples", f"{without:.2f} %")
    yield Row(
        what, "samples add", f"{added:.2f} %", added / AT_MOST_PERCENT, 1.0, f"to {AT_MOST_PERCENT:g} % of a core"
    )


def percent_of_core(*, samples: bool) -> float:
    """Returns the CPU time per second of the robots' time, in %."""
    now_s = 0.0
    config = load_config({"signals": {name: {"warn_below": 5.0, "stale_after_s": 5.0} for name in SIGNALS}})
    with tempfile.TemporaryDirectory() as folder:
        settings = HistorySettings(str(Path(folder, "history.db")), samples=samples)
        with closing(History(settings, lambda: _BEGIN_S + now_s)) as history:
            robots = []
            for number in range(ROBOTS):
                monitor = Monitor(config, robot=f"robot_{number}")
                robots.append((monitor, Continuity(monitor, history.of_robot(f"robot_{number}"))))
                robots[-1][1].restore(0.0, at_first_call=False)
            history.run(lambda connection: None, _PATIENCE_S)
            begin_s = time.process_time()
            for second in range(SECONDS):
                now_s = second + 0.3
                for monitor, continuity in robots:
                    for name in SIGNALS:
                        monitor.observe(Sample(name, 50.0 + second % 7, now_s))
                    monitor.tick(now_s)
                    continuity.save(now_s)
                history.run(lambda connection: None, _PATIENCE_S)  # waits until everything is written
            return (time.process_time() - begin_s) / SECONDS * 100.0
