"""The monitor announces what a model of docs/rules.md says, over random robots whose topics, links and causes fail."""

from __future__ import annotations

import os
import random
from typing import Any

import pytest
from harness.seeds import fixed_seed
from harness.silence_model import Line, Model, Signal, random_robot

from robot_health_monitor.core import Monitor, Sample, load_config
from robot_health_monitor.core.config.causes import causes_of

pytestmark = pytest.mark.newest_python

TIMELINES = int(os.environ.get("ROBOT_HEALTH_TIMELINES", "200"))
"""`make fuzz` plays 100,000."""


def play(chance: random.Random) -> None:
    """Plays one random timeline to the monitor and to the model."""
    signals = random_robot(chance)
    config = load_config({"signals": signals})
    monitor = Monitor(config)
    monitor.expect_sources()
    fields = ("name", "topic", "stale_after_s", "depends_on")
    model = Model(
        [
            Signal(*(getattr(each, key) for key in fields[:3]), each.startup_grace_s, each.depends_on)
            for each in config.signals.values()
        ]
    )
    found: list[Line] = []
    log: list[str] = [repr(signals)]

    def note(changes: Any) -> None:
        found.extend((each.now_s, each.signal, each.to_level.name) for each in changes if each.signal != "link")

    topics = list(dict.fromkeys(each["topic"] for each in signals.values()))
    alive = dict.fromkeys(topics, chance.random() < 0.8)
    missing: dict[str, bool] = dict.fromkeys(signals, False)
    up, now_s = True, 0.0
    note(monitor.tick(now_s))
    model.tick()
    for _ in range(80):
        now_s = model.now_s = now_s + chance.choice((0.25, 0.5, 1.0, 1.0, 1.0))
        if chance.random() < 0.08:  # a power rail: several at once
            state = chance.random() < 0.5
            alive.update((topic, state) for topic in topics if chance.random() < 0.7)
        if chance.random() < 0.1:
            topic = chance.choice(topics)
            alive[topic] = not alive[topic]
        if chance.random() < 0.05:
            name = chance.choice(list(signals))
            missing[name] = not missing[name]
        if chance.random() < 0.03:
            up = not up
            log.append(f"{now_s} link {up}")
            note(monitor.set_link(up, "", now_s))
            model.link(up)
        for topic in topics if up else ():
            if alive[topic] and chance.random() < 0.8:
                on_topic = [
                    name for name in causes_of(config.signals).first(config.signals) if signals[name]["topic"] == topic
                ]
                samples = {name: chance.choice((0.0, 0.0, 0.0, 2.0)) for name in on_topic if not missing[name]}
                log.append(f"{now_s} {topic} {samples}")
                note(monitor.observe_source(topic, now_s))
                for name, value in samples.items():
                    note(monitor.observe(Sample(name, value, now_s)))
                model.message(topic, samples)
        if chance.random() < 0.7:
            log.append(f"{now_s} tick")
            note(monitor.tick(now_s))
            model.tick()
        assert found == model.lines, "\n".join([*log, f"monitor {found[-4:]}", f"model   {model.lines[-4:]}"])


def test_random_timelines_are_announced_as_the_model_says() -> None:
    seed = fixed_seed()
    for number in range(TIMELINES):
        play(random.Random(f"{seed} {number}"))
