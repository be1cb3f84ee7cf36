"""The fuzzer itself: it finds what it should, and a run of a few seconds finds nothing."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest
from fuzz.targets import Target
from fuzz.work import Work


def load_main() -> Any:
    import runpy

    return runpy.run_path(str(Path(__file__).parent / "__main__.py"))["main"]


class Toy(Target):
    """A target whose inputs are the numbers 0 to 9."""

    name = "toy"
    errors = (KeyError,)

    def make(self, chance: random.Random) -> int:
        return chance.randrange(10)

    def use(self, data: int) -> None:
        raise KeyError(data)

    def allowed(self, data: int) -> Work:
        return Work(1_000, 1_000_000)


class Raising(Toy):
    def use(self, data: int) -> None:
        if data == 7:
            raise ValueError("seven")


class Busy(Toy):
    def use(self, data: int) -> None:
        sum(abs(number) for number in range(1_000))


class Hungry(Toy):
    def use(self, data: int) -> None:
        bytes(2_000_000)


@pytest.mark.parametrize(
    ("target", "found"),
    [(Raising, "ValueError: seven"), (Busy, "more than 1000 calls"), (Hungry, "bytes of memory, allowed 1000000")],
)
def test_it_finds_other_errors_and_too_much_work(capsys: Any, target: Any, found: str) -> None:
    main = load_main()
    assert main(["--seconds", "5", "--seed", "1"], [target]) == 1
    printed = capsys.readouterr().out
    assert found in printed
    case = printed.split("--case ")[1].split()[0]
    assert main(["--seed", "1", "--case", case], [target]) == 1  # the line that it prints repeats the case


def test_the_errors_of_the_project_are_none(capsys: Any) -> None:
    assert load_main()(["--seconds", "0.1", "--seed", "1"], [Toy]) == 0


@pytest.mark.newest_python
def test_a_short_run_finds_nothing(capsys: Any) -> None:
    assert load_main()(["--seconds", "3", "--seed", "1"]) == 0, capsys.readouterr().out
