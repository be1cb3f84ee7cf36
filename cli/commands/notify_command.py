"""`robot-health notify`: sends a test notification to every target of an ops.yaml, without the queue."""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import sys
import threading
import time
from functools import partial
from typing import Any, Callable, NamedTuple, Sequence

from ...core.config import read_yaml
from ...core.nodes.node import host_name
from ...core.nodes.outlets import json_line
from ...core.values import Clock, ConfigError, Level, Status, Transition, duration_text, printable
from ...ops.configuration import TargetSettings, read_ops
from ...ops.notify.alertmanager import ALERT, REPEAT_EVERY_S
from ...ops.notify.notifier import make_sender
from ...ops.notify.sender import DeliveryError, Notification, Sender
from ...ops.notify.webhook import Webhook
from ...runtime.event_loops import run_in_daemon_thread
from ...runtime.interrupts import Interrupts
from ..arguments import Parser, add, checked, duration
from ..exit_codes import ExitCode

_ALERTMANAGER_HOLD_S = 60.0
"""How long a test alert stays at Alertmanager by default, in s: it notifies after its `group_wait`, default 30 s."""

_POLL_PERIOD_S = 0.2

_FURTHER_S = 30.0  # how long a target may take beyond its timeouts, for instance to resolve a host name


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Sends a test alert to every target of an ops.yaml, then resolves it, and reports each response."
    )
    add(parser, "FILE", "an ops.yaml")
    meaning = (
        "how long the test alert stays, such as 90s or 0 (default: 60s at alertmanager, which notifies after its "
        "group_wait, and 0 at all other targets)"
    )
    add(parser, "--hold TIME", meaning, type=_hold)


def _hold_s(text: str) -> Any:
    try:
        return float(text)  # 0, and seconds without their unit
    except ValueError:
        return duration(text)


_hold = checked("a duration of at most a day, such as 90s", _hold_s, lambda hold_s: 0.0 <= hold_s <= 86_400.0)


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Sends a test alert to every target at once, resolves it, and writes a line per target in the order of the file.

    Returns whether all accepted it, as the exit code; raises ConfigError if the file cannot be used, or has no targets.
    """
    targets = read_ops(read_yaml(arguments.file)).notify
    if not targets:
        raise ConfigError("expected targets in the section notify, got none", file=arguments.file)
    interrupts.defer()  # whenever it comes, the test alerts are resolved before the end
    return asyncio.run(_try_all(targets, arguments.hold, interrupts))


def _write(name: str, text: str) -> None:
    sys.stdout.write(f"{printable(f'{name}: {text}')}\n")
    sys.stdout.flush()


class Trial(NamedTuple):
    """How a target responded to a test."""

    name: str
    succeeded: bool
    text: str  # one line: where the target is, and its response or the failure; no secrets
    warning: str = ""  # one line about the target that is no failure, or empty


async def _try_all(targets: Sequence[TargetSettings], hold_s: float | None, interrupts: Interrupts) -> ExitCode:
    """Tries each target in a thread. The alert stays for `hold_s`, else as the target needs, or until SIGINT."""
    stop = threading.Event()
    trials: dict[str, asyncio.Future[Trial]] = {}
    for target in targets:
        by_default_s = _ALERTMANAGER_HOLD_S if target.type == "alertmanager" else 0.0
        held_s = by_default_s if hold_s is None else hold_s
        write = partial(_write, target.name)
        run = run_in_daemon_thread(partial(try_target, target, host_name() or "robot", held_s, stop, write))
        limit_s = held_s + 3.0 * target.timeout_s + _FURTHER_S
        trials[target.name] = asyncio.ensure_future(asyncio.wait_for(run, limit_s))
    code = ExitCode.SUCCESS
    for name, running in trials.items():
        while not running.done():
            await asyncio.wait({running}, timeout=_POLL_PERIOD_S)
            if interrupts.came:
                stop.set()
        error = running.exception()
        what = "no response" if isinstance(error, asyncio.TimeoutError) else f"internal error: {type(error).__name__}"
        trial = Trial(name, False, what) if error else running.result()  # the text of an error may contain a secret
        if not trial.succeeded:
            code = ExitCode.FAILED
        _write(name, f"{'OK' if trial.succeeded else 'FAILED'}: {trial.text}")
        if trial.warning:
            sys.stderr.write(f"{printable(trial.warning)}\n")
    return code


def try_target(
    settings: TargetSettings,
    robot: str,
    hold_s: float = 0.0,
    stop: threading.Event | None = None,
    on_firing: Callable[[str], object] = lambda text: None,
    wall_time_s: Clock = time.time,
) -> Trial:
    """Sends a test alert of the target's `min_level` for the signal `test`, then resolves it; calls a heartbeat once.

    The alert stays for `hold_s`, or until `stop`; then `on_firing` receives a line that says what to look for.
    """
    target = make_sender(settings, wall_time_s)
    try:
        if isinstance(target, Webhook) and settings.type == "heartbeat":
            response = target.deliver(None)
        else:
            begin_s = wall_time_s()
            firing = Notification(_transition(robot, Level.OK, settings.min_level), False, begin_s, is_test=True)
            response = target.send(firing)
            sent, hint = 2, f': look for "{firing.text}" and its end'
            if hold_s > 0.0:
                on_firing(f"firing: {target.place}: {response}; {_what_to_look_for(settings, firing, hold_s)}")
                sent, hint = sent + _hold_alert(hold_s, stop or threading.Event(), firing, target), ""
            ended = _transition(robot, settings.min_level, Level.OK)
            at_s = max(wall_time_s(), begin_s)
            target.send(Notification(ended, True, at_s, before=firing, is_test=True))
            response += f"; {sent} messages sent{hint}"
    except DeliveryError as error:
        return Trial(settings.name, False, f"{target.place}: {error}", target.warning)
    return Trial(settings.name, True, f"{target.place}: {response}", target.warning)


def _what_to_look_for(settings: TargetSettings, firing: Notification, hold_s: float) -> str:
    text = f'look for "{firing.text}"; it is resolved in {duration_text(hold_s)}'
    if settings.type == "alertmanager":
        text += (
            ". Alertmanager notifies after its group_wait (default 30 s), or its group_interval (default 5 min) if the "
            "group has an alert already (then --hold 6m); its page shows "
            f"alertname={ALERT}, robot={firing.robot}, signal=test"
        )
    return text


def _hold_alert(hold_s: float, stop: threading.Event, firing: Notification, target: Sender) -> int:
    """Waits; repeats the alert to a target that needs it, and returns how often. Raises DeliveryError."""
    end_s = time.monotonic() + hold_s
    repeated = 0
    while not stop.wait(max(0.0, min(REPEAT_EVERY_S, end_s - time.monotonic()))) and time.monotonic() < end_s:
        if target.repeat_every_s < math.inf:
            target.send(firing)
            repeated += 1
    return repeated


def _transition(robot: str, from_level: Level, to_level: Level) -> dict[str, object]:
    """Returns a transition with the fields of `--json`."""
    text = f"test {to_level.name}: test notification of robot-health notify, nothing is wrong"
    status = Status("test", to_level, text, robot, {})
    announced = Transition("test", from_level, to_level, None, "last", None, 0.0, 0.0, robot, "0" * 16, text, status)
    fields: dict[str, object] = json.loads(json_line(announced, alert_id=0))
    return fields
