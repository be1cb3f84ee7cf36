"""The fuzzer, `make fuzz`: invalid input raises the project's own errors only, and causes a bounded amount of work.

    make fuzz                                          every target, one minute in total
    make fuzz ARGS="--seconds 600 --target core"       one target, ten minutes
    make fuzz ARGS="--seed 7 --target core --case 42"  one case again: a failure prints this line

A case depends only on the seed, the target and its number. Exit code 1 after the first failure.
"""

from __future__ import annotations

import argparse
import contextlib
import random
import resource
import sys
import time
import traceback
from pathlib import Path
from typing import Sequence

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS.parent), str(TESTS)]

from fuzz.recorded import RECORDED_TARGETS  # noqa: E402  # found through the line above
from fuzz.stored import STORED_TARGETS  # noqa: E402
from fuzz.targets import TARGETS, Target  # noqa: E402
from fuzz.work import TooMuchWork, bounded, limited_time, measured  # noqa: E402

SHOWN_CHARS = 3_000
MOST_BYTES = 8 * 2**30
_MEASURED = 4
"""The work of every fourth case is measured, which makes it slow."""


def main(
    arguments: Sequence[str] | None = None,
    targets: Sequence[type[Target]] = (*TARGETS, *RECORDED_TARGETS, *STORED_TARGETS),
) -> int:
    """Runs the targets, each for an equal part of the time; returns the exit code."""
    names = [target.name for target in targets]
    parser = argparse.ArgumentParser(prog="make fuzz", description="feeds random input to everything that takes input")
    parser.add_argument("--seconds", type=float, default=60.0, help="time limit")
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**9))
    parser.add_argument("--target", choices=names, action="append", help="only this one; may be repeated")
    parser.add_argument("--case", type=int, help="only the case of this number")
    options = parser.parse_args(arguments)
    print(f"seed {options.seed}", flush=True)
    chosen = [target for target in targets if target.name in (options.target or names)]
    end_s = time.monotonic()
    for make_target in chosen:
        end_s += options.seconds / len(chosen)
        target = make_target()
        try:
            number, most = options.case or 0, 0.0
            while True:
                problem = try_case(target, options.seed, number)
                if problem:
                    print(f"{target.name} failed: --seed {options.seed} --target {target.name} --case {number}")
                    print(problem)
                    return 1
                most = max(most, measured.share)
                number += 1
                if options.case is not None or time.monotonic() >= end_s:
                    break
        finally:
            target.close()
        print(f"{target.name:<16}{number:>8} cases, at most {most:.0%} of the allowed work", flush=True)
    return 0


def try_case(target: Target, seed: int, number: int) -> str:
    """Runs one case; returns what is wrong, empty if nothing is."""
    data = target.make(random.Random(f"{seed} {target.name} {number}"))
    try:
        with limited_time(), bounded(target.allowed(data)) if number % _MEASURED == 0 else contextlib.nullcontext():
            target.use(data)
    except target.errors as error:
        text = str(error)
        if "\n" in text or len(text) > target.longest_error:
            return f"the error is not one short line: {text[:SHOWN_CHARS]!r}\ninput: {shown(data)}"
    except TooMuchWork as problem:
        return f"{problem}\ninput: {shown(data)}"
    except Exception:
        return f"{traceback.format_exc()}\ninput: {shown(data)}"
    return ""


def shown(data: object) -> str:
    """Returns the input, shortened."""
    try:
        text = repr(data)
    except ValueError:  # a number too long to be printed
        return "use --case to see it"
    parts: list[str] = [text] if len(text) <= SHOWN_CHARS else [text[:SHOWN_CHARS], f"... ({len(text)} characters)"]
    return "".join(parts)


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))  # a bomb must not take the machine with it
    sys.exit(main())
