"""Signals become one clean end, whenever they come."""

from __future__ import annotations

import os
import signal
from typing import Iterator, List

import pytest

from robot_health_monitor.__main__ import Interrupts, main

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    """Gives the signals back to pytest."""
    before = {number: signal.getsignal(number) for number in ENDING_SIGNALS}
    yield
    for number in ENDING_SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # forgets one that is blocked
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING_SIGNALS)
    for number, handler in before.items():
        signal.signal(number, handler)


def test_the_first_signal_interrupts_and_a_second_does_not_disturb_the_end() -> None:
    with Interrupts():
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGTERM)
    os.kill(os.getpid(), signal.SIGTERM)  # the process is on its way out


def test_once_somebody_listens_every_signal_is_a_call() -> None:
    calls: List[None] = []
    with Interrupts() as interrupts:
        interrupts.on_interrupt = lambda: calls.append(None)
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGINT)
    assert len(calls) == 2


def test_without_an_interrupt_the_signals_are_given_back() -> None:
    before = [signal.getsignal(number) for number in ENDING_SIGNALS]
    assert main(["--version"]) == 0
    assert [signal.getsignal(number) for number in ENDING_SIGNALS] == before


def test_main_returns_the_code_of_wrong_usage(capsys: pytest.CaptureFixture) -> None:
    assert main(["run", "--bogus"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
