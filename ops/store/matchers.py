"""Which alerts are meant: matchers such as `robot=r3,signal=battery*`, and patterns of names."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import NamedTuple, Sequence

from ...core.values import ConfigError, matches_pattern

MOST_MATCHERS = 20

_LONGEST = 500
_MATCHER = re.compile(r'\s*(robot|signal)\s*(!?=)\s*("(?:[^"\\]|\\.)+"|[^\s~,"](?:[^,"]*[^\s,"])?)\s*(?:,|\Z)')
_ESCAPED = re.compile(r'\\(["\\])')
_SPECIAL = re.compile(r'["\\]')


class Matcher(NamedTuple):
    """A condition on one label of an alert."""

    label: str
    """`robot` or `signal`."""
    equal: bool
    """Whether the label must match the pattern; for `!=` it must not."""
    pattern: str
    """`*` stands for any text, `?` for any character."""

    def matches(self, text: str) -> bool:
        """Returns whether a label with this text fulfils the condition."""
        return matches_pattern(text, self.pattern) is self.equal


@lru_cache(maxsize=2000)
def parse_matchers(text: str) -> tuple[Matcher, ...]:
    """Reads matchers: `robot=r3,signal=battery*`.

    `=` and `!=`; `*` and `?` as in file names; a value with a comma or a quote in double quotes, with a backslash
    before a quote or another backslash in it.

    Raises:
        ConfigError: they are not of this form.
    """
    if len(text) > _LONGEST or not text.isprintable():
        raise ConfigError(f"expected at most {_LONGEST} printable characters, got {ascii(text)[:60]}")
    matchers: list[Matcher] = []
    position = 0
    while position < len(text) or not matchers:
        match = _MATCHER.match(text, position)
        if match is None:
            part = text[position:].partition(",")[0].strip()
            raise ConfigError(
                "expected matchers such as robot=r3,signal=battery*: robot or signal, = or !=, and a name with * and ?"
                f"; got {part[:60]!r}"
            )
        label, operator, value = match.groups()
        pattern = _ESCAPED.sub(r"\1", value[1:-1]) if value.startswith('"') else value
        matchers.append(Matcher(label, operator == "=", pattern))
        position = match.end()
    if len(matchers) > MOST_MATCHERS:
        raise ConfigError(f"expected at most {MOST_MATCHERS} matchers, got {len(matchers)}")
    return tuple(matchers)


def matchers_text(matchers: Sequence[Matcher]) -> str:
    """Returns matchers as `parse_matchers` reads them."""

    def quoted(pattern: str) -> str:
        # Spaces at the ends would be stripped, and a ~ after the operator would look like a regular expression.
        needs_quotes = re.search(r'[,"]|^[\s~]|\s$', pattern)
        return '"{}"'.format(_SPECIAL.sub(r"\\\g<0>", pattern)) if needs_quotes else pattern

    return ",".join(f"{each.label}{'=' if each.equal else '!='}{quoted(each.pattern)}" for each in matchers)
