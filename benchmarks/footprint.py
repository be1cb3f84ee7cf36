"""Memory and CPU of the three nodes and of health_monitor, compared with a node that does nothing.

All run at the same time, as launched, with three metrics at 1 Hz. A bare node publishes and receives three numbers at
the same rate, for comparison: on a virtual machine whose host reclaims idle memory, this alone can exceed the limit for
health_monitor.
"""

from __future__ import annotations

import contextlib
import time
from typing import Dict, Iterator

from benchmarks.table import Row
from benchmarks.targets import Process, Target

EMPTY, BARE, COMPOSED = "empty node", "bare node, same topics", "health_monitor (composed)"
NODES = ("battery_sensor", "aggregator", "alert_system")
WARM_UP_S = 10.0
MEASURE_S = 40.0
MEMORY_AT_MOST = 1.25
CPU_AT_MOST_PERCENT = 1.0


def rows(target: Target, measure_s: float = MEASURE_S) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    with contextlib.ExitStack() as running:
        processes: Dict[str, Process] = {EMPTY: target.peer("empty"), BARE: target.peer("exercise")}
        processes[COMPOSED] = target.node("health_monitor", "composed")
        processes.update((name, target.node(name, "separate")) for name in NODES)
        for process in processes.values():
            running.callback(process.end)
        time.sleep(WARM_UP_S)
        begin_s = time.monotonic()
        used_s = {name: process.cpu_s() for name, process in processes.items()}
        time.sleep(measure_s)
        percent = {name: process.cpu_s() - used_s[name] for name, process in processes.items()}
        took_s = time.monotonic() - begin_s
        percent = {name: 100.0 * used / took_s for name, used in percent.items()}
        resident_mb = {name: process.resident_mb() for name, process in processes.items()}
        own_mb = {name: process.own_mb() for name, process in processes.items()}

    for what, found in (("resident memory", resident_mb), ("private memory", own_mb)):
        for name, megabytes in found.items():
            ratio = megabytes / found[EMPTY]
            required = MEMORY_AT_MOST if name == COMPOSED else None
            remark = "" if name == EMPTY else "to the empty node"
            yield Row(f"{target.name}, {what}", name, f"{megabytes:.1f} MB", ratio, required, remark)
    for name, share in percent.items():
        required = CPU_AT_MOST_PERCENT if name == COMPOSED else None
        yield Row(
            f"{target.name}, CPU", name, f"{share:.2f} %", share / CPU_AT_MOST_PERCENT, required, "to 1 % of a core"
        )
