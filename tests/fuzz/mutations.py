"""Changes valid input at random: most of it stays valid, so that the change gets past the first check."""

from __future__ import annotations

import copy
import math
import random
import sys
from typing import Any, Sequence

NUMBERS: Sequence[Any] = (
    0,
    1,
    -1,
    20.0,
    0.5,
    1e308,
    -1e308,
    5e-324,
    sys.float_info.max,
    math.nan,
    math.inf,
    -math.inf,
    2**63,
    -(2**64),
    10**400,
    -(10**5000),
    True,
)
TEXTS: Sequence[str] = (
    "",
    "x",
    "link",
    "battery_level",
    "std_msgs/Float32",
    "std_msgs/__init__",
    "../../etc/passwd",
    "a" * 5000,
    "\x1b[31mred\x1b[0m",
    "two\nlines",
    "\u202eright to left",
    "\ud800",
    "\x00",
    "~/x",
    "/x//y",
    "data[0].value{key=x}",
    "9" * 5000,
    "%s{}",
    "\uff2e\uff21\uff2e",
)
OTHERS: Sequence[Any] = (None, [], {}, [[]], [None], {"": None}, b"\xff\x00", [1.0, "x", {}], {"a": {"b": {}}})


def any_value(chance: random.Random, deepest: int = 3) -> Any:
    """Returns a value, often an odd one."""
    kind = chance.randrange(8)
    if kind == 0 and deepest:
        return [any_value(chance, deepest - 1) for _ in range(chance.randrange(5))]
    if kind == 1 and deepest:
        return {any_text(chance): any_value(chance, deepest - 1) for _ in range(chance.randrange(5))}
    if kind == 2:
        return copy.deepcopy(chance.choice(OTHERS))
    if kind == 3:
        return any_text(chance)
    if kind == 4:
        return chance.gauss(50.0, 50.0)
    if kind == 5:
        return "".join(chr(chance.choice((chance.randrange(128), chance.randrange(0x11000)))) for _ in range(5))
    return chance.choice(NUMBERS)


def any_text(chance: random.Random) -> str:
    """Returns an odd text."""
    return chance.choice(TEXTS)


def mutate_tree(chance: random.Random, tree: Any, others: Sequence[Any] = ()) -> Any:
    """Returns a copy with some values and keys changed, removed, repeated, or moved between the trees."""
    tree = copy.deepcopy(tree)
    for _ in range(chance.choice((0, 1, 1, 2, 3, 6))):
        places = list(_places(tree))
        if not places:
            return any_value(chance)
        container, key = chance.choice(places)
        what = chance.randrange(6)
        if what == 0:
            del container[key]
        elif what == 1 and isinstance(container, dict):
            container[chance.choice((any_text(chance), f"{key}x", str(key)[1:]))] = container.pop(key)
        elif what == 2 and others:
            found = [part[name] for part, name in _places(chance.choice(others))]
            container[key] = copy.deepcopy(chance.choice(found)) if found else None
        elif what == 3:
            source, name = chance.choice(places)
            container[key] = copy.deepcopy(source[name]) if name in source or isinstance(source, list) else None
        else:
            container[key] = any_value(chance)
    return tree


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """Returns every container in a tree with each of its keys."""
    found: list[tuple[Any, Any]] = []
    open_trees = [tree]
    while open_trees:
        container = open_trees.pop()
        keys = list(container) if isinstance(container, dict) else range(len(container))
        if isinstance(container, (dict, list)):
            for key in keys:
                found.append((container, key))
                if isinstance(container[key], (dict, list)):
                    open_trees.append(container[key])
    return found


def mutate_bytes(chance: random.Random, data: bytes, pieces: Sequence[bytes]) -> bytes:
    """Returns a copy with some bytes changed, removed or repeated, or with pieces of other input inserted."""
    changed = bytearray(data)
    for _ in range(chance.choice((0, 1, 1, 2, 4, 8))):
        place = chance.randrange(len(changed) + 1)
        what = chance.randrange(6)
        if what == 0 and changed:
            changed[min(place, len(changed) - 1)] = chance.randrange(256)
        elif what == 1:
            del changed[place : place + chance.choice((1, 2, 5, 50))]
        elif what == 2:
            changed[place:place] = chance.choice(pieces)
        elif what == 3:
            changed[place:place] = changed[place : place + 20] * chance.choice((1, 2, 100))
        elif what == 4:
            changed[place:place] = bytes(chance.randrange(256) for _ in range(chance.randrange(1, 10)))
        else:
            other = chance.randrange(len(changed) + 1)
            piece = changed[other : other + 30]
            changed[place : place + len(piece)] = piece
    return bytes(changed)
