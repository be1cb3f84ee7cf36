"""Patterns of names, as in file names: `*` stands for any text, `?` for any character."""

from __future__ import annotations


def matches_pattern(text: str, pattern: str) -> bool:
    """Returns whether a text matches a pattern, in time proportional to the product of their lengths.

    fnmatch needs exponential time for some patterns on Python 3.8, and clients may send patterns.
    """
    if pattern == "*":
        return True
    position = place = 0
    star, retry = -1, 0
    while position < len(text):
        if place < len(pattern) and pattern[place] == "*":
            star, retry = place, position
            place += 1
        elif place < len(pattern) and pattern[place] in ("?", text[position]):
            place += 1
            position += 1
        elif star >= 0:
            retry += 1
            position, place = retry, star + 1
        else:
            return False
    return pattern[place:].strip("*") == ""
