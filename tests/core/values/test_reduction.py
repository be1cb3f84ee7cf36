"""`reduce`: all elements of an array become one value, judged like any other, with the element that decided."""

from __future__ import annotations

import math
from typing import Any, Sequence

import pytest

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.judge.quality import as_float
from robot_health_monitor.core.values.elements import NOT_A_NUMBER, Age, BadDatum, DriverStatus, Elements
from robot_health_monitor.core.values.reduction import Element, reduced

CELLS = {"topic": "battery", "field": "cell_voltage[*]", "unit": "V"}


def cells(*values: Any) -> Elements:
    return Elements((str(index), value) for index, value in enumerate(values))


def monitor(**settings: Any) -> Monitor:
    return Monitor(load_config({"signals": {"cells": {**CELLS, **settings}}}), robot="r1")


def lines(samples: Sequence[Any], **settings: Any) -> list[str]:
    """Returns the lines of samples that come every second."""
    watch = monitor(**settings)
    return [
        change.text
        for second, value in enumerate(samples)
        for change in watch.observe(Sample("cells", value, float(second)))
    ]


@pytest.mark.parametrize(
    ("reduction", "value", "decided"),
    [
        ("min", 3.0, (Element("1", 3.0),)),
        ("max", 3.75, (Element("2", 3.75),)),
        ("mean", 3.4375, ()),
        ("spread", 0.75, (Element("1", 3.0), Element("2", 3.75))),
        ("sum", 13.75, ()),
        ("count", 4.0, ()),
    ],
)
def test_elements_become_one_value_and_the_elements_that_decided_are_known(
    reduction: str, value: float, decided: object
) -> None:
    found = reduced(cells(3.5, 3.0, 3.75, 3.5), reduction, float)
    assert (found, found.decided, found.measured, found.skipped, found.problem) == (value, decided, 4, 0, "")


def test_the_first_of_equal_elements_is_named() -> None:
    assert reduced(cells(4.0, 3.0, 3.0), "min", float).decided == (Element("1", 3.0),)


def test_a_spread_of_one_element_is_zero() -> None:
    assert reduced(cells(3.5), "spread", float) == 0.0


def test_a_sum_keeps_small_digits_beside_large_numbers() -> None:
    assert reduced(cells(1e16, 1.0, -1e16), "sum", float) == 1.0


def test_a_sum_that_is_too_large_is_infinite() -> None:
    assert reduced(cells(1e308, 1e308), "sum", float) == math.inf
    assert reduced(cells(1e308, -1e308), "spread", float) == math.inf


def test_the_reason_names_the_weakest_cell() -> None:
    good, weak = cells(*[3.75] * 8), cells(*[3.75] * 7, 3.12)
    assert lines([good, weak, good], reduce="min", warn_below=3.2) == [
        "cells WARN: 3.12 V (cell_voltage[7]) is below 3.2 V (was OK for 1 s)",
        "cells OK: 3.75 V (cell_voltage[0]) is no longer below 3.2 V (was WARN for 1 s)",
    ]


def test_the_reason_of_a_spread_names_the_smallest_and_the_largest_element() -> None:
    assert lines([cells(3.5, 3.25, 3.75)], reduce="spread", warn_above=0.12) == [
        "cells WARN: 0.5 V (cell_voltage[1] to cell_voltage[2]) is above 0.12 V (was unknown for 0 s)"
    ]


def test_the_reason_of_a_spread_of_equal_elements_names_one() -> None:
    assert lines([cells(3.5, 3.5)], reduce="spread", warn_below=0.1) == [
        "cells WARN: 0 V (cell_voltage[0]) is below 0.1 V (was unknown for 0 s)"
    ]


@pytest.mark.parametrize(("reduction", "value"), [("mean", "3.5 V"), ("sum", "7 V"), ("count", "2 V")])
def test_reductions_that_no_element_decides_name_none(reduction: str, value: str) -> None:
    assert lines([cells(3.25, 3.75)], reduce=reduction, warn_below=100.0) == [
        f"cells WARN: {value} is below 100 V (was unknown for 0 s)"
    ]


def test_a_statistic_of_a_reduction_names_the_latest_element() -> None:
    samples = [cells(3.0, 3.5), cells(3.5, 3.0), cells(3.0, 3.5), cells(3.5, 3.0)]
    assert lines(samples, reduce="min", statistic="mean", window_s=4.0, warn_below=3.2) == [
        "cells WARN: mean 3 V (latest cell_voltage[0]) is below 3.2 V (was OK for 2 s)"
    ]


@pytest.mark.parametrize(
    ("field", "name", "path"),
    [
        ('effort["*"]', "wheel_left", 'effort["wheel_left"]'),
        ("status[*].level", "3", "status[3].level"),
        ('interface_values["*"].values["effort"]', "arm", 'interface_values["arm"].values["effort"]'),
        ("packs[1].cells[*]", "0", "packs[1].cells[0]"),
        ('effort["*"]', "bad\x1b[31m", 'effort["bad?[31m"]'),
    ],
)
def test_an_element_is_named_by_the_path_to_it(field: str, name: str, path: str) -> None:
    assert lines([Elements([(name, 5.0)])], field=field, reduce="max", warn_above=1.0) == [
        f"cells WARN: 5 V ({path}) is above 1 V (was unknown for 0 s)"
    ]


def test_elements_that_are_not_measured_are_skipped_and_counted() -> None:
    watch = monitor(reduce="min", placeholders=[-0.01], warn_below=3.2)
    samples = cells(3.75, math.nan, -0.01, None, "x", 3.5, math.inf, BadDatum("no time stamp"))
    assert not watch.observe(Sample("cells", samples, 0.0))
    values = watch.report(0.0).statuses["cells"].values
    assert (values["value"], values["element"], values["elements"], values["elements_skipped"]) == (
        "3.5", "cell_voltage[5]", "2", "6"
    )  # fmt: skip


def test_the_status_of_a_spread_has_both_ends() -> None:
    watch = monitor(reduce="spread")
    watch.observe(Sample("cells", cells(3.5, 3.25, 3.75), 0.0))
    values = watch.report(0.0).statuses["cells"].values
    found = {name: values[name] for name in ("value", "lowest", "lowest_value", "highest", "highest_value")}
    assert found == {
        "value": "0.5", "lowest": "cell_voltage[1]", "lowest_value": "3.25", "highest": "cell_voltage[2]",
        "highest_value": "3.75",
    }  # fmt: skip
    assert "element" not in values


@pytest.mark.parametrize(
    ("elements", "reason"),
    [
        (cells(), "no elements"),
        (cells(math.nan, None), "none of 2 elements is measured"),
        (BadDatum("10001 elements (limit 10000)"), "10001 elements (limit 10000)"),
        (
            BadDatum("interface_values has 3 elements, joint_names has 5"),
            "interface_values has 3 elements, joint_names has 5",
        ),
    ],
)
def test_nothing_measured_is_invalid_data_with_the_reason(elements: Any, reason: str) -> None:
    assert lines([elements], reduce="min", warn_below=3.2) == [
        f"cells ERROR: invalid data: {reason} (was unknown for 0 s)"
    ]


def test_the_number_of_a_whole_status_is_its_level() -> None:
    statuses = Elements([("lidar", DriverStatus(0, "")), ("motor", DriverStatus(2, "")), ("odd", DriverStatus(7, ""))])
    assert lines([statuses], field='status["*"]', unit="", reduce="max", warn_above=1.0) == [
        'cells WARN: 2 (status["motor"]) is above 1 (was unknown for 0 s)'
    ]


def test_a_count_of_nothing_is_zero_and_never_a_placeholder() -> None:
    assert lines([cells(), cells(math.nan)], reduce="count", placeholders=[0.0], unit="", warn_below=1.0) == [
        "cells WARN: 0 is below 1 (was unknown for 0 s)"
    ]


def test_a_count_counts_texts_messages_and_statuses_but_no_missing_values() -> None:
    elements = cells("left", NOT_A_NUMBER, DriverStatus(0, ""), 0.0, True, None, math.nan, BadDatum("no time stamp"))
    assert reduced(elements, "count", as_float) == 5.0


def test_elements_are_scaled_before_they_are_reduced_so_that_a_negative_scale_turns_them_around() -> None:
    assert lines([cells(1.0, 5.0)], reduce="max", scale=-1000.0, unit="mV", warn_above=-2000.0) == [
        "cells WARN: -1000 mV (cell_voltage[0]) is above -2000 mV (was unknown for 0 s)"
    ]


def test_a_count_is_not_scaled() -> None:
    assert lines([cells(1.0, 5.0)], reduce="count", scale=100.0, unit="", warn_above=1.0) == [
        "cells WARN: 2 is above 1 (was unknown for 0 s)"
    ]


def test_the_valid_range_is_that_of_the_reduced_value_and_the_reason_names_the_element() -> None:
    assert lines([cells(3.5, 0.0)], reduce="min", valid_min=1.0, warn_below=3.2) == [
        "cells ERROR: invalid data: 0 V (cell_voltage[1]) is below valid_min 1 (was unknown for 0 s)"
    ]


def test_an_age_below_zero_among_the_elements_says_that_clocks_differ() -> None:
    assert lines([cells(Age(2.0), Age(-0.5))], field="poses[*].stamp", unit="s", reduce="max", warn_above=1.0) == [
        "cells WARN: 2 s (poses[0].stamp) is above 1 s, clocks differ (was unknown for 0 s)"
    ]


def test_an_array_that_shrinks_is_judged_by_the_elements_that_are_left() -> None:
    assert lines([cells(3.75, 3.0), cells(3.75)], reduce="min", warn_below=3.2) == [
        "cells WARN: 3 V (cell_voltage[1]) is below 3.2 V (was unknown for 0 s)",
        "cells OK: 3.75 V (cell_voltage[0]) is no longer below 3.2 V (was WARN for 1 s)",
    ]


def test_a_window_holds_reduced_values() -> None:
    watch = monitor(reduce="min")
    watch.observe(Sample("cells", cells(3.5, 3.75), 0.0))
    watch.observe(Sample("cells", cells(3.25, 3.75), 1.0))
    assert list(watch.window_samples("cells")) == [(0.0, 3.5), (1.0, 3.25)]
    assert watch.fresh_value("cells") == 3.25
    assert watch.report(1.0).overall is Level.OK
