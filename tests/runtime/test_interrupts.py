"""SIGINT and SIGTERM end a process once and cleanly, whatever its main thread is doing."""

from __future__ import annotations

import os
import signal
import threading
from typing import Iterator

import pytest

from robot_health_monitor.__main__ import main
from robot_health_monitor.runtime.interrupts import Interrupts

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    """Restores pytest's handlers."""
    numbers = (*ENDING_SIGNALS, signal.SIGALRM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)  # discards one that is blocked
    signal.pthread_sigmask(signal.SIG_UNBLOCK, numbers)
    for number, handler in before.items():
        signal.signal(number, handler)


def test_the_first_signal_interrupts_and_a_second_does_not_disturb_the_end() -> None:
    with Interrupts():
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGTERM)
    os.kill(os.getpid(), signal.SIGTERM)  # the process is on its way out


def test_deferred_signals_are_raised_where_the_program_checks() -> None:
    with Interrupts() as interrupts:
        interrupts.defer()
        interrupts.check()
        interrupts.wait_until(lambda: True)
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupts.came
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
        with pytest.raises(KeyboardInterrupt):
            interrupts.wait_until(lambda: False)


def test_something_that_hangs_is_interrupted_after_all() -> None:
    with Interrupts(patience_s=0.05) as interrupts:
        interrupts.defer()
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            threading.Event().wait(30.0)


def test_without_a_signal_the_handlers_are_restored() -> None:
    numbers = (*ENDING_SIGNALS, signal.SIGALRM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    with Interrupts(patience_s=1.0):
        assert [signal.getsignal(number) for number in numbers] != before
    assert [signal.getsignal(number) for number in numbers] == before


def test_outside_the_main_thread_it_does_nothing() -> None:
    before = signal.getsignal(signal.SIGINT)
    seen: list[object] = []

    def enter() -> None:
        with Interrupts():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join(10.0)
    assert seen == [before]


def test_main_restores_the_handlers() -> None:
    before = [signal.getsignal(number) for number in ENDING_SIGNALS]
    assert main(["--version"]) == 0
    assert [signal.getsignal(number) for number in ENDING_SIGNALS] == before


def test_main_returns_the_code_of_wrong_usage(capsys: pytest.CaptureFixture) -> None:
    assert main(["run", "--bogus"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_hangup_is_noted_and_ends_nothing() -> None:
    with Interrupts() as interrupts:
        interrupts.take_hangups()
        assert not interrupts.hung_up
        os.kill(os.getpid(), signal.SIGHUP)
        assert interrupts.hung_up
        assert not interrupts.came


def test_without_take_hangups_the_handler_stays_as_it_was() -> None:
    before = signal.getsignal(signal.SIGHUP)
    with Interrupts():
        assert signal.getsignal(signal.SIGHUP) is before
    with Interrupts() as interrupts:
        interrupts.take_hangups()
    assert signal.getsignal(signal.SIGHUP) is before
