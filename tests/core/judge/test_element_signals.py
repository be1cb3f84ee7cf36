"""The section "Each element by itself" of docs/rules.md."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.config.signal_config import LONGEST_NAME, is_element_name
from robot_health_monitor.core.judge.element_signals import MOST_REFUSED, element_of, element_signal_name
from robot_health_monitor.core.values.elements import BadDatum, Elements
from robot_health_monitor.core.values.errors import ConfigError

CELLS = {"field": "cell_voltage[*]", "unit": "V", "warn_below": 3.2}


def monitor(**signals: dict[str, Any]) -> Monitor:
    return Monitor(load_config({"signals": signals}), "r1")


def see(watched: Monitor, now_s: float, name: str = "cells", **elements: Any) -> list[str]:
    values = Elements((key.lstrip("_"), value) for key, value in elements.items())
    return texts(watched.observe(Sample(name, values, now_s)))


def texts(changes: Any) -> list[str]:
    return [str(each) for each in changes]


def levels(watched: Monitor, now_s: float) -> dict[str, str]:
    return {name: status.level.name for name, status in watched.report(now_s).statuses.items()}


class TestAnElement:
    def test_is_a_signal_with_the_configuration_of_its_template(self) -> None:
        watched = monitor(cells=CELLS)
        assert watched.tick(0.0) == []
        assert see(watched, 11.0, _0=3.9, _7=3.1) == [
            "11.000 cells[7] WARN: 3.1 V is below 3.2 V (was unknown for 11 s)"
        ]
        assert see(watched, 12.0, _0=3.9, _7=3.9) == [
            "12.000 cells[7] OK: 3.9 V is no longer below 3.2 V (was WARN for 1 s)"
        ]

    def test_has_a_fingerprint_of_its_own(self) -> None:
        watched = monitor(cells=CELLS)
        see(watched, 0.0, _0=3.9, _1=3.9)
        prints = [status.values["fingerprint"] for status in watched.report(0.0).statuses.values()]
        assert len(set(prints)) == 3

    def test_follows_its_template_in_the_order_of_the_configuration(self) -> None:
        watched = monitor(a={}, cells=CELLS, z={})
        watched.observe(Sample("link", 1.0, 0.0))
        see(watched, 0.0, _1=3.9, _0=3.9)
        see(watched, 1.0, _2=3.9)
        assert list(watched.report(1.0).statuses) == ["a", "cells", "cells[1]", "cells[0]", "cells[2]", "z", "link"]

    def test_that_is_no_longer_sent_becomes_stale_when_an_array_shrinks(self) -> None:
        watched = monitor(cells=CELLS)
        see(watched, 0.0, _0=3.9, _1=3.9)
        for second in range(1, 8):
            see(watched, float(second), _0=3.9)
            last = texts(watched.tick(float(second)))
            if second == 6:
                assert last == ["6.000 cells[1] STALE: no sample for 6 s (limit 5 s) (was OK for 6 s)"]
        assert levels(watched, 7.0) == {"cells": "OK", "cells[0]": "OK", "cells[1]": "STALE"}

    def test_can_be_observed_by_its_full_name(self) -> None:
        watched = monitor(drivers={**CELLS, "field": 'status["*"].level'})
        watched.observe(Sample("drivers[a: b[c]]", 3.0, 0.0))
        assert see(watched, 1.0, "drivers", **{"a: b[c]": 3.9}) == [
            "1.000 drivers[a: b[c]] OK: 3.9 V is no longer below 3.2 V (was WARN for 1 s)"
        ]
        assert list(watched.report(1.0).statuses) == ["drivers", "drivers[a: b[c]]"]

    def test_of_an_unknown_template_is_ignored(self) -> None:
        watched = monitor(cells=CELLS, battery={})
        for name in ("packs[1]", "battery[1]", "cells[1", "cells[\n]", "cells[" + 200 * "x" + "]"):
            assert watched.observe(Sample(name, 1.0, 0.0)) == []
        assert list(watched.report(0.0).statuses) == ["cells", "battery"]

    def test_that_is_latched_is_cleared_by_reset(self) -> None:
        watched = monitor(cells={**CELLS, "latch": True})
        see(watched, 0.0, _0=3.1)
        assert see(watched, 1.0, _0=3.9) == []
        assert [each.text for each in watched.reset()] == [
            "cells[0] OK: 3.9 V is no longer below 3.2 V (was WARN for 1 s)"
        ]

    @pytest.mark.newest_python
    def test_that_changes_at_400_hertz_is_no_storm_of_alerts(self) -> None:
        watched = monitor(cells=CELLS)
        announced = sum(len(see(watched, n / 400.0, _0=3.1 if n % 2 else 3.9, _1=3.9)) for n in range(400 * 60))
        assert announced == 61

    def test_is_frozen_while_the_link_is_down_also_if_it_comes_meanwhile(self) -> None:
        watched = monitor(cells=CELLS)
        watched.set_link(True, "", 0.0)
        see(watched, 0.0, _0=3.9)
        watched.set_link(False, "refused", 1.0)
        assert see(watched, 1.5, _1=3.1) == []
        assert texts(watched.tick(100.0)) == []
        assert levels(watched, 100.0) == {"cells": "STALE", "cells[0]": "STALE", "cells[1]": "STALE", "link": "ERROR"}
        assert [each.signal for each in watched.set_link(True, "", 101.0)] == ["cells[1]"]

    def test_does_not_grow_silent_while_the_process_was_stopped(self) -> None:
        watched = monitor(cells={**CELLS, "forget_after_s": 20.0})
        see(watched, 0.0, _0=3.9)
        watched.skip(0.0, 3600.0)
        assert watched.tick(3601.0) == []
        assert list(watched.report(3601.0).statuses) == ["cells", "cells[0]"]


class TestATemplate:
    def test_without_elements_is_stale(self) -> None:
        watched = monitor(cells=CELLS)
        watched.tick(0.0)
        assert watched.levels()["cells"] == (Level.STALE, "waiting")
        assert texts(watched.tick(11.0)) == [
            "11.000 cells STALE: no sample since the start 11 s ago (limit 10 s) (was unknown for 11 s)"
        ]
        assert see(watched, 12.0) == []  # an empty array
        assert see(watched, 13.0, _0=3.9) == ["13.000 cells OK: 1 element (was STALE for 2 s)"]

    def test_can_have_a_hint_before_its_first_element(self) -> None:
        watched = monitor(cells=CELLS)
        watched.expect_sources()
        watched.tick(0.0)
        assert [each.name for each in watched.without_samples(5.0)] == ["cells"]
        watched.note_hint("cells", "no publisher on /cells")
        (transition,) = watched.tick(11.0)
        assert transition.hint == "no publisher on /cells"

    def test_has_the_number_of_its_elements_as_value(self) -> None:
        watched = monitor(cells=CELLS)
        see(watched, 0.0, _0=3.9, _1=3.0)
        status = watched.report(0.0).statuses["cells"]
        assert (status.level, status.message, status.values["value"]) == (Level.OK, "2 elements", "2")

    def test_whose_elements_all_fall_silent_is_not_one_alert_more(self) -> None:
        watched = monitor(cells=CELLS)
        see(watched, 0.0, _0=3.9, _1=3.9)
        announced = [each.signal for second in range(1, 100) for each in watched.tick(float(second))]
        assert announced == ["cells[0]", "cells[1]"]

    def test_that_received_no_array_is_an_error_until_it_receives_one(self) -> None:
        watched = monitor(cells=CELLS)
        see(watched, 0.0, _0=3.9)
        (transition,) = watched.observe(Sample("cells", BadDatum("20000 elements (limit 10000)"), 1.0))
        assert (transition.signal, transition.to_level) == ("cells", Level.ERROR)
        assert watched.tick(1.5) == []
        assert see(watched, 2.0, _0=3.9) == []
        assert texts(watched.tick(3.0)) == ["3.000 cells OK: 1 element (was ERROR for 2 s)"]

    @pytest.mark.parametrize("value", [3.9, None, "text", {}, [("0", 3.9)], object()])
    def test_judges_whatever_it_receives(self, value: object) -> None:
        watched = monitor(cells=CELLS)
        (transition,) = watched.observe(Sample("cells", value, 0.0))
        assert transition.to_level is Level.ERROR

    @pytest.mark.parametrize("name", [7, None, b"x", [], {}])
    def test_names_elements_by_text(self, name: Any) -> None:
        watched = monitor(cells=CELLS)
        watched.observe(Sample("cells", Elements([(name, 3.9)]), 0.0))
        assert list(watched.report(0.0).statuses) == ["cells", f"cells[{name!r}]"]


class TestTooManyElements:
    def test_the_first_ones_stay(self) -> None:
        watched = monitor(cells={**CELLS, "max_elements": 2})
        see(watched, 0.0, _0=3.9, _1=3.9, _2=3.9, _3=3.9)
        see(watched, 1.0, _3=3.9, _2=3.9, _1=3.9, _0=3.0)
        assert levels(watched, 1.0) == {"cells": "OK", "cells[0]": "WARN", "cells[1]": "OK"}
        assert watched.excess_elements() == {"cells": 2}

    def test_the_excess_is_over_a_minute_after_it_was_seen_last(self) -> None:
        watched = monitor(cells={**CELLS, "max_elements": 1})
        see(watched, 0.0, _0=3.9, _1=3.9)
        watched.tick(60.0)
        assert watched.excess_elements() == {"cells": 1}
        watched.tick(61.0)
        assert watched.excess_elements() == {}

    def test_a_driver_that_renames_itself_with_each_message_is_bounded(self) -> None:
        watched = monitor(cells=CELLS)
        announced = 0
        for n in range(20_000):
            announced += len(see(watched, n * 0.01, **{f"driver {n}": 3.9}))
        assert announced == 0
        assert len(watched.report(200.0).statuses) == 201
        assert watched.excess_elements() == {"cells": MOST_REFUSED}

    @pytest.mark.parametrize(("most", "per_minute"), [(5, 60), (200, 200)])
    def test_new_names_per_minute_are_bounded_although_others_end(self, most: int, per_minute: int) -> None:
        watched = monitor(cells={**CELLS, "max_elements": most, "stale_after_s": 0.01, "forget_after_s": 0.02})
        seen = set()
        for n in range(33 * 120):  # two minutes
            see(watched, n / 33.0, **{f"driver {n}": 3.9})
            watched.tick(n / 33.0 + 0.01)
            seen |= {name for name in watched.signals() if name != "cells"}
        assert len(seen) == 2 * per_minute

    def test_ten_thousand_elements_are_two_hundred_signals(self) -> None:
        watched = monitor(cells=CELLS)
        many = Elements((str(n), 3.9) for n in range(10_000))
        for second in range(3):
            assert watched.observe(Sample("cells", many, float(second))) == []
        assert list(watched.report(2.0).statuses)[-1] == "cells[199]"


class TestForgetting:
    def test_an_element_ends_when_its_last_sample_is_too_old(self) -> None:
        watched = monitor(cells={**CELLS, "forget_after_s": 20.0})
        see(watched, 0.0, _0=3.9, _1=3.1)
        announced = []
        for second in range(1, 31):
            announced += see(watched, float(second), _1=3.1) if second < 5 else []
            announced += texts(watched.tick(float(second)))
        assert announced == [
            "6.000 cells[0] STALE: no sample for 6 s (limit 5 s) (was OK for 6 s)",
            "10.000 cells[1] STALE: no sample for 6 s (limit 5 s) (was WARN for 10 s)",
            "21.000 cells[0] OK: no longer watched (was STALE for 15 s)",
            "25.000 cells[1] OK: no longer watched (was STALE for 15 s)",
            "30.000 cells STALE: no sample for 6 s (limit 5 s) (was OK for 30 s)",
        ]
        assert list(watched.report(30.0).statuses) == ["cells"]

    def test_the_downtime_of_the_link_does_not_count(self) -> None:
        watched = monitor(cells={**CELLS, "forget_after_s": 20.0})
        watched.set_link(True, "", 0.0)
        see(watched, 0.0, _0=3.9)
        watched.set_link(False, "", 1.0)
        watched.tick(1000.0)
        watched.set_link(True, "", 1000.0)
        watched.tick(1004.0)
        assert "cells[0]" in watched.signals()

    def test_makes_room_for_others(self) -> None:
        watched = monitor(cells={**CELLS, "max_elements": 1, "forget_after_s": 20.0})
        see(watched, 0.0, _0=3.9)
        see(watched, 10.0, _1=3.9)
        watched.tick(21.0)
        see(watched, 22.0, _1=3.1)
        assert levels(watched, 22.0) == {"cells": "OK", "cells[1]": "WARN"}

    def test_an_element_that_comes_again_was_unknown_at_least_since_then(self) -> None:
        watched = monitor(cells={**CELLS, "forget_after_s": 20.0})
        see(watched, 0.0, _0=3.9)
        watched.tick(21.0)
        assert see(watched, 24.0, _0=3.1) == [
            "24.000 cells[0] WARN: 3.1 V is below 3.2 V (was unknown for 3 s)",
            "24.000 cells OK: 1 element (was STALE for 3 s)",
        ]


class TestConditions:
    def test_of_a_template_hold_for_each_element_from_its_first_sample_on(self) -> None:
        watched = monitor(charging={}, cells={**CELLS, "only_if": {"signal": "charging", "is": 0.0}})
        watched.observe(Sample("charging", 1.0, 0.0))
        assert see(watched, 1.0, _0=3.1) == []
        (transition,) = watched.observe(Sample("charging", 0.0, 2.0))
        assert (transition.signal, transition.to_level) == ("cells[0]", Level.WARN)

    def test_may_refer_to_an_element_by_its_full_name(self) -> None:
        watched = monitor(cells=CELLS, heat={"warn_above": 50.0, "only_if": {"signal": "cells[1]", "above": 3.5}})
        see(watched, 0.0, _1=3.3)
        assert watched.observe(Sample("heat", 60.0, 1.0)) == []
        (transition,) = watched.observe(Sample("cells", Elements([("1", 3.6)]), 2.0))
        assert (transition.signal, transition.to_level) == ("heat", Level.WARN)

    @pytest.mark.parametrize("signal", ["packs[1]", "heat[1]", "cells[1", "cells[0]"])
    def test_may_not_refer_to_an_element_that_cannot_come(self, signal: str) -> None:
        cells = {**CELLS, "only_if": {"signal": signal, "is": 1.0}}
        with pytest.raises(ConfigError, match="expected the name of another signal"):
            load_config({"signals": {"cells": cells, "heat": {}}})


class TestANewConfiguration:
    def test_leaves_the_elements_of_unchanged_signals_alone(self) -> None:
        watched = monitor(cells=CELLS, a={})
        see(watched, 0.0, _0=3.1, _1=3.9)
        assert watched.configure(load_config({"signals": {"b": {}, "cells": CELLS}})) == []
        assert see(watched, 1.0, _0=3.1, _1=3.9) == []
        assert levels(watched, 1.0) == {"b": "STALE", "cells": "OK", "cells[0]": "WARN", "cells[1]": "OK"}

    def test_applies_to_all_elements_at_once(self) -> None:
        watched = monitor(cells=CELLS)
        see(watched, 0.0, _0=3.1, _1=3.9)
        changes = watched.configure(load_config({"signals": {"cells": {**CELLS, "warn_below": 4.0}}}))
        assert [each.text for each in changes] == ["cells[1] WARN: 3.9 V is below 4 V (was OK for 0 s)"]

    def test_ends_the_elements_of_a_removed_or_moved_template(self) -> None:
        for after in ({"a": {}}, {"cells": {**CELLS, "topic": "other"}}, {"cells": {"warn_below": 3.2}}):
            watched = monitor(cells=CELLS)
            see(watched, 0.0, _0=3.1, _1=3.9)
            changes = watched.configure(load_config({"signals": after}))
            assert [each.text for each in changes] == ["cells[0] OK: no longer watched (was WARN for 0 s)"]
            assert list(watched.report(0.0).statuses) == list(after)

    def test_of_fewer_elements_keeps_the_first_ones(self) -> None:
        watched = monitor(cells=CELLS)
        see(watched, 0.0, _0=3.9, _1=3.9, _2=3.9)
        watched.configure(load_config({"signals": {"cells": {**CELLS, "max_elements": 2}}}))
        assert list(watched.report(0.0).statuses) == ["cells", "cells[0]", "cells[1]"]

    def test_may_make_a_template_of_a_signal(self) -> None:
        watched = monitor(cells={"warn_below": 3.2})
        watched.observe(Sample("cells", 3.1, 0.0))
        changes = watched.configure(load_config({"signals": {"cells": CELLS}}))
        assert [each.text for each in changes] == ["cells OK: no longer watched (was WARN for 0 s)"]
        assert watched.levels() == {"cells": (Level.STALE, "waiting")}


class TestARestart:
    def restarted(self, watched: Monitor, now_s: float, **signals: Any) -> tuple[Monitor, list[str]]:
        names = list(watched.signals())
        states = json.loads(json.dumps({name: watched.snapshot(name, now_s, 1e9 + now_s) for name in names}))
        after = monitor(**signals)
        return after, [each.text for each in after.restore(states, 0.0, 1e9 + now_s + 60.0, 1e9 + now_s)]

    def test_continues_with_the_elements_that_were_known(self) -> None:
        watched = monitor(cells=CELLS)
        see(watched, 0.0, _0=3.9, **{"a: b": 3.1})
        after, announced = self.restarted(watched, 10.0, cells=CELLS)
        assert announced == []
        assert list(after.report(0.0).statuses) == ["cells", "cells[0]", "cells[a: b]"]
        assert see(after, 1.0, **{"a: b": 3.9}) == [
            "1.000 cells[a: b] OK: 3.9 V is no longer below 3.2 V (was WARN for 71 s)"
        ]
        assert [each.text for each in after.tick(11.0)] == [
            "cells[0] STALE: no sample since the start 11 s ago (limit 10 s) (was OK for 10 s)",
            "cells[a: b] STALE: no sample for 10 s (limit 5 s) (was OK for 10 s)",
        ]

    def test_ends_the_alerts_of_elements_that_are_no_longer_watched(self) -> None:
        watched = monitor(cells=CELLS)
        see(watched, 0.0, _0=3.9, _1=3.1)
        after, announced = self.restarted(watched, 10.0, battery={})
        assert announced == ["cells[1] OK: no longer watched (was WARN for 70 s)"]
        after, announced = self.restarted(watched, 10.0, cells={**CELLS, "max_elements": 1})
        assert list(after.report(0.0).statuses) == ["cells", "cells[0]"]
        assert announced == ["cells[1] OK: no longer watched (was WARN for 70 s)"]

    @pytest.mark.parametrize("name", ["cells[\x1b]", "cells[" + "x" * 200 + "]", "cells[", "[1]", "cells]"])
    def test_ignores_a_saved_name_that_is_none(self, name: str) -> None:
        after = monitor(cells=CELLS)
        changes = after.restore({name: {"announced": {"level": "WARN"}}}, 0.0, 1e9)
        assert changes == []
        assert len(changes.notices) == 1
        assert list(after.report(0.0).statuses) == ["cells"]


class TestNames:
    @pytest.mark.newest_python
    @given(st.lists(st.text(), min_size=2, max_size=5, unique=True), st.integers(1, 60))
    def test_are_printable_short_and_different(self, elements: list[str], length: int) -> None:
        template = "c" * length
        names = [element_signal_name(template, element) for element in elements]
        assert all(name.isprintable() and len(name) <= LONGEST_NAME and is_element_name(name) for name in names)
        assert len(set(names)) == len(elements)

    def test_that_are_printable_and_short_stay_as_they_are(self) -> None:
        assert element_signal_name("drivers", 'a="b", [c]: d') == 'drivers[a="b", [c]: d]'
        assert element_of('drivers[a="b", [c]: d]') == 'a="b", [c]: d'

    def test_of_two_elements_that_would_look_the_same_differ(self) -> None:
        watched = monitor(cells=CELLS)
        see(watched, 0.0, **{"a\n": 3.9, "a\r": 3.1, "a?": 3.9})
        shown = list(levels(watched, 0.0).items())
        assert [(name[:8], level) for name, level in shown[1:]] == [
            ("cells[a?", "OK"), ("cells[a?", "WARN"), ("cells[a?", "OK"),
        ]  # fmt: skip
        assert len(dict(shown)) == 4

    def test_of_a_megabyte_are_not_kept(self) -> None:
        watched = monitor(cells=CELLS)
        for n in range(3):
            see(watched, float(n), **{"x" * 1_000_000: 3.9})
        (_, name) = watched.report(2.0).statuses
        assert len(name) == LONGEST_NAME


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"field": "data", "max_elements": 5}, r"max_elements: expected a field such as cell_voltage\[\*\]"),
        ({"field": "data", "forget_after_s": 5.0}, r"forget_after_s: expected a field such as cell_voltage\[\*\]"),
        ({"field": "a[*]", "forget_after_s": 5.0}, r"expected more than stale_after_s \(5\), got 5"),
        ({"field": "a[*]", "max_elements": 0}, "max_elements"),
        ({"field": "a[*]", "max_elements": 10_001}, "max_elements"),
    ],
)
def test_mistakes_are_configuration_errors(keys: dict[str, Any], problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        load_config({"signals": {"cells": keys}})


def test_a_template_has_a_short_name() -> None:
    with pytest.raises(ConfigError, match="expected a signal name of at most 60 characters with it, got 61"):
        load_config({"signals": {"c" * 61: CELLS}})


elements = st.lists(st.tuples(st.text(max_size=3) | st.integers(), st.floats() | st.text(max_size=2) | st.none()))


@pytest.mark.newest_python
@given(st.lists(st.tuples(elements | st.floats() | st.none(), st.floats()), max_size=20))
def test_nothing_makes_it_raise_and_the_transitions_form_chains(calls: list[tuple[Any, float]]) -> None:
    watched = monitor(cells={**CELLS, "max_elements": 5, "forget_after_s": 30.0, "flap_detection": True})
    announced: dict[str, Level] = {}
    for value, now_s in calls:
        given_value = Elements(value) if isinstance(value, list) else value
        for each in [*watched.observe(Sample("cells", given_value, now_s)), *watched.tick(now_s + 1.0)]:
            assert announced.get(each.signal, Level.OK) is each.from_level is not each.to_level
            announced[each.signal] = each.to_level
        assert len(watched.report(now_s).statuses) <= 6
