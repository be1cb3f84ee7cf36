"""The soak test, `make soak`: memory, threads and files must stay flat; kill -9 must lose and repeat nothing; stored
samples must equal the raw ones.

    make soak                              two thousand kills, a million samples in virtual time, ten minutes of
                                           clients, ten minutes of a thousand alerts per second, thirty days of stored
                                           samples
    make soak ARGS="--minutes 1"           a short run
    make soak ARGS="--samples 0 --kills 0 --storm-minutes 0 --days 0 --seed 7"   only the real time part of another run

Prints the figures. Exit code 1 if one of them is not flat, or a transition or latch was lost or repeated.
"""

from __future__ import annotations

import argparse
import random
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS.parent), str(TESTS)]

from soak import (  # noqa: E402  # found through the line above
    black_boxes,
    kill,
    kill_samples,
    real_time,
    samples,
    storm,
    virtual_time,
)
from soak.figures import Figure, table  # noqa: E402


def main(arguments: list[str] | None = None) -> int:
    """Runs the parts; returns the exit code."""
    parser = argparse.ArgumentParser(prog="make soak", description="checks that memory, threads and files stay flat")
    parser.add_argument("--minutes", type=float, default=10.0, help="duration of the real time part")
    parser.add_argument("--samples", type=int, default=1_000_000, help="samples of the virtual time part")
    parser.add_argument("--kills", type=int, default=1_000, help="how often two monitors are killed")
    parser.add_argument("--storm-minutes", type=float, default=10.0, help="duration of the storm of alerts")
    parser.add_argument("--storm-mb", type=float, default=20.0, help="keep_mb of the history in the storm")
    parser.add_argument(
        "--days", type=float, default=30.0, help="days of samples that a history stores in virtual time"
    )
    parser.add_argument("--sample-period", type=float, default=2.0, help="time between these samples, in s")
    parser.add_argument("--black-boxes", type=int, default=50, help="random black boxes that are replayed")
    parser.add_argument("--black-box-kills", type=int, default=42, help="how often a black box is killed as it writes")
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**9))
    options = parser.parse_args(arguments)
    print(f"seed {options.seed}", flush=True)
    figures: list[Figure] = []
    if options.kills:  # first: it forks, which is safe only while there is one thread
        for part in (kill, kill_samples):
            violations, counts = part.run(options.kills, options.seed)
            print("\n".join([", ".join(f"{name}: {count}" for name, count in counts.items()), *violations]), flush=True)
            if violations:
                return 1
    if options.black_boxes or options.black_box_kills:
        violations = black_boxes.run(options.black_boxes, options.black_box_kills, options.seed)
        print("\n".join(violations), flush=True)
        if violations:
            return 1
    if options.samples:
        figures += virtual_time.run(options.samples, options.seed)
        print(table(figures), flush=True)
    if options.minutes:
        in_real_time = real_time.run(options.minutes * 60.0, options.seed)
        print(table(in_real_time), flush=True)
        figures += in_real_time
    if options.storm_minutes:
        in_storm = storm.run(options.storm_minutes * 60.0, options.storm_mb, options.seed)
        print(table(in_storm), flush=True)
        figures += in_storm
    if options.days:
        differences, stored = samples.run(options.days, options.sample_period, options.seed)
        print("\n".join([table(stored), *differences[:20]]), flush=True)
        figures += stored
        if differences:
            return 1
    return 0 if all(figure.is_met for figure in figures) else 1


if __name__ == "__main__":
    sys.exit(main())
