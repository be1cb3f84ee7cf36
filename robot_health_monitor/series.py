"""Series of samples in the notation of `promtool test rules`.

A series is a list of items, separated by spaces:

=============  =================================================================
item           samples
=============  =================================================================
`25`           one sample of 25; also `nan`, `inf`, `-inf`
`25x9`         ten samples of 25: a value and nine repetitions
`15-0.5x20`    21 samples: 15, 14.5, 14, ... 5
`20+2x3`       four samples: 20, 22, 24, 26
`_`            one missing sample
`_x3`          three missing samples
=============  =================================================================

As in promtool, `x9` after a value adds nine samples to it, and `_x3` is three missing samples, not four.
Source: https://prometheus.io/docs/prometheus/latest/configuration/unit_testing_rules/#series
"""

from __future__ import annotations

import re
from typing import List, Optional

from robot_health_monitor.core.errors import ConfigError, Path
from robot_health_monitor.core.parameters import describe

MOST_SAMPLES = 1_000_000
"""Longest series."""

_NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?"
_VALUE = re.compile(rf"(?P<value>[+-]?(?:{_NUMBER}|nan|inf))(?:(?P<step>[+-]{_NUMBER})?x(?P<times>\d+))?\Z", re.I)
_MISSING = re.compile(r"_(?:x(?P<times>\d+))?\Z")


def parse_series(text: str, path: Path = ()) -> List[Optional[float]]:
    """Returns the samples of a series; None for a missing one.

    Args:
        text: the series.
        path: its place in a file, for errors.

    Raises:
        ConfigError: it is not in the notation, is empty, or is longer than `MOST_SAMPLES`.
    """
    samples: List[Optional[float]] = []
    for item in text.split():
        missing, value = _MISSING.match(item), _VALUE.match(item)
        if missing:
            times = _times(missing["times"] or "1", samples, path)
            samples.extend([None] * times)
        elif value:
            start, step = float(value["value"]), float(value["step"] or 0.0)
            times = _times(value["times"] or "0", samples, path)
            # Not by adding up: 20.5-0.1x5 must end at 20 exactly.
            samples.extend(start + step * count if step else start for count in range(times + 1))
        else:
            raise ConfigError(f"expected a series such as '25x9 15-0.5x20 _x3 nan', got {describe(item)} in it", path)
    if not samples:
        raise ConfigError("expected a series such as '25x9 15-0.5x20 _x3 nan', got no samples", path)
    return samples


def _times(digits: str, samples: List[Optional[float]], path: Path) -> int:
    # A number of a million digits would take Python minutes.
    times = int(digits) if len(digits) < 10 else MOST_SAMPLES
    if len(samples) + times + 1 > MOST_SAMPLES:
        raise ConfigError(f"expected at most {MOST_SAMPLES} samples in a series", path)
    return times
