"""Seeds for random choices. They are printed, which pytest shows when a test fails; `TEST_SEED=7` sets them."""

from __future__ import annotations

import os
import random


def fixed_seed() -> int:
    """Returns the seed for input: the same in every run, so that a test that has passed does not fail by chance."""
    return _printed(1)


def new_seed() -> int:
    """Returns the seed for moments, such as that of a kill: another one in every run."""
    return _printed(random.SystemRandom().randrange(10**9))


def _printed(seed: int) -> int:
    seed = int(os.environ.get("TEST_SEED") or seed)
    print(f"TEST_SEED={seed}")
    return seed


def examples(number: int) -> int:
    """Returns how many random examples a test tries: half of `number` in `make test`.

    With TEST_EXAMPLES it is so many times `number`, which `make fuzz` sets. On a Python that is not the newest it is
    a tenth: another session tries the half, and what depends on the version shows in any of them.
    """
    factor = float(os.environ.get("TEST_EXAMPLES") or (0.1 if os.environ.get("NEWEST_PYTHON_SESSION") else 0.5))
    return max(1, round(number * factor))


def every(number: int) -> int:
    """Returns the step of a test that damages a file at one place in `number`: 1 where TEST_EXAMPLES is set."""
    return 1 if os.environ.get("TEST_EXAMPLES") else number
