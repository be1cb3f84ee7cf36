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
