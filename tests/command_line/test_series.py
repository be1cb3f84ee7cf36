"""The notation of series: by hand, and by Prometheus's own promtool."""

from __future__ import annotations

import math
import shutil
import subprocess
from pathlib import Path
from typing import List, Optional

import pytest

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.series import MOST_SAMPLES, parse_series

PROMTOOL = shutil.which("promtool")


@pytest.mark.parametrize(
    ("text", "samples"),
    [
        ("25", [25.0]),
        ("25x9", [25.0] * 10),
        ("25x0", [25.0]),
        ("1 2  3", [1.0, 2.0, 3.0]),
        ("15-0.5x4", [15.0, 14.5, 14.0, 13.5, 13.0]),
        ("20+2x3", [20.0, 22.0, 24.0, 26.0]),
        ("-2-1x2", [-2.0, -3.0, -4.0]),
        ("-2+4x1", [-2.0, 2.0]),
        ("_", [None]),
        ("_x3 1", [None, None, None, 1.0]),
        ("_x0 1", [1.0]),
        ("1e3 1.5e-1x1 .5", [1000.0, 0.15, 0.15, 0.5]),
        ("inf -Inf", [math.inf, -math.inf]),
    ],
)
def test_a_series_is_its_samples(text: str, samples: List[Optional[float]]) -> None:
    assert parse_series(text) == samples


def test_a_falling_series_ends_at_its_last_value_exactly() -> None:
    assert parse_series("20.5-0.1x5")[-1] == 20.0


@pytest.mark.parametrize("text", ["nan", "NaN", "-nan"])
def test_nan_is_a_sample(text: str) -> None:
    (sample,) = parse_series(text)
    assert sample is not None
    assert math.isnan(sample)


@pytest.mark.parametrize(
    "text", ["x3", "1x", "1y3", "1x-3", "1+x3", "1+2", "one", "0xF", "1,2", "_1", "1_000", "²", "1x1.5"]
)
def test_an_item_that_is_not_in_the_notation_is_named(text: str) -> None:
    with pytest.raises(ConfigError, match=r"expected a series such as .* got") as raised:
        parse_series(f"1 {text} 2", ("tests", "0"))
    assert repr(text)[1:-1] in str(raised.value)
    assert str(raised.value).startswith("tests.0: ")


@pytest.mark.parametrize("text", ["", "   ", "_x0"])
def test_a_series_without_samples_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="got no samples"):
        parse_series(text)


@pytest.mark.parametrize(
    "text", ["1x1000000", "1x999999999999999999999", "_x1000001", "1x600000 2x600000", "1x" + "9" * 10**6]
)
def test_a_series_that_is_too_long_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=f"expected at most {MOST_SAMPLES} samples"):
        parse_series(text)


@pytest.mark.skipif(PROMTOOL is None, reason="promtool is not installed (Debian's package prometheus)")
@pytest.mark.parametrize(
    "text", ["25x9 15-0.5x20", "1 _ 2 _x3 3x2 _ 4", "20+2x3 -2-1x2 -2+4x1", "_x5 7x0 8x1", "1e3 1.5e-1x1"]
)
def test_promtool_reads_the_same_samples(text: str, tmp_path: Path) -> None:
    assert PROMTOOL is not None
    lines = ["tests:", "  - interval: 10m", "    input_series:", f"      - {{series: s, values: '{text}'}}"]
    lines.append("    promql_expr_test:")
    samples = parse_series(text)
    # A step further than the series, to compare its length. The interval is longer than Prometheus looks back.
    for number, sample in enumerate([*samples, None]):
        found = "[]" if sample is None else f"[{{labels: s, value: {sample!r}}}]"
        lines.append(f"      - {{expr: s, eval_time: {number * 10}m, exp_samples: {found}}}")
    file = tmp_path / "test.yaml"
    file.write_text("\n".join(lines))
    run = subprocess.run(
        [PROMTOOL, "test", "rules", str(file)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert run.returncode == 0, run.stdout
