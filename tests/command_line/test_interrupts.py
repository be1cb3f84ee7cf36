"""Signals become one clean end, whenever they come."""

from __future__ import annotations

import os
import signal
from typing import List

import pytest

from robot_health_monitor.__main__ import Interrupts, main


def test_the_first_signal_interrupts_and_a_second_does_not_disturb_the_end() -> None:
    before = signal.getsignal(signal.SIGTERM)
    try:
        with Interrupts():
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGTERM)  # the process is on its way out
    finally:
        signal.signal(signal.SIGTERM, before)
        signal.signal(signal.SIGINT, signal.default_int_handler)


def test_once_somebody_listens_every_signal_is_a_call() -> None:
    before = signal.getsignal(signal.SIGTERM)
    calls: List[None] = []
    try:
        with Interrupts() as interrupts:
            interrupts.on_interrupt = lambda: calls.append(None)
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGINT)
    finally:
        signal.signal(signal.SIGTERM, before)
        signal.signal(signal.SIGINT, signal.default_int_handler)
    assert len(calls) == 2


def test_without_an_interrupt_the_signals_are_given_back() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    assert main(["--version"]) == 0
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_main_returns_the_code_of_wrong_usage(capsys: pytest.CaptureFixture) -> None:
    assert main(["run", "--bogus"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
