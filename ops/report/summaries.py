"""The summary of a signal, of a replay or of a history: a row of a table or of a report."""

from __future__ import annotations

from typing import Counter, Mapping, NamedTuple, Sequence

from ...core.config import SignalConfig
from ...core.judge import judged_unit
from ...core.values import Level, number_text, with_unit

SHARES = (*(level.name for level in Level), "unknown")
"""Heads of the columns with shares of time."""
_WORST_FIRST = sorted((level for level in Level if level is not Level.OK), key=lambda level: -level.severity)


class SummaryRow(NamedTuple):
    """What is shown of one signal."""

    signal: str
    group: str
    """The name of its configuration or robot; empty if there is only one."""
    cause: str
    """The name of the alert of which it was an effect, if it was not announced itself; empty if it was none."""
    shares: Mapping[Level, float]
    """Share of time per announced level, 0 to 1; levels that did not occur may be missing."""
    unknown: float
    """Share of time in which the level is not known, 0 to 1."""
    alerts: int
    figures: Mapping[str, str]
    """Further cells by the heads of their columns; they come before those that follow from the other fields."""

    @property
    def badness(self) -> tuple[float, ...]:
        """The shares of the levels, the worst first, and what else is bad: the greater, the worse."""
        return (*(self.shares.get(level, 0.0) for level in _WORST_FIRST), self.alerts, self.unknown)

    def cells(self, heads: Sequence[str], effects: int = 0) -> list[str]:
        """Returns the cells of these columns; with `effects`, as `folded` counts them, the name shows that."""
        name = f"  {self.signal}" if effects < 0 else f"{self.signal} (+ {effects} affected)"
        shares = (*(self.shares.get(level, 0.0) for level in Level), self.unknown)
        texts = {
            "signal": name if effects else self.signal,
            "file": self.group,
            "robot": self.group,
            **dict(zip(SHARES, map(share_text, shares))),
            "alerts": str(self.alerts),
            **self.figures,
        }
        return [texts[head] for head in heads]


def folded(rows: Sequence[SummaryRow]) -> list[tuple[SummaryRow, int]]:
    """Returns rows with each effect below its cause, and how many effects follow each: -1 for an effect."""
    places = {(row.group, row.signal): at for at, row in enumerate(rows) if not row.cause}
    causes = [places.get((row.group, row.cause), -1) for row in rows]
    order = sorted(range(len(rows)), key=lambda at: (at, -1) if causes[at] < 0 else (causes[at], at))
    effects = Counter(causes)
    return [(rows[at], effects[at] if causes[at] < 0 else -1) for at in order]


def table(heads: Sequence[str], rows: Sequence[SummaryRow]) -> list[list[str]]:
    """Returns the cells of a table with its heads; effects are indented below their cause."""
    return [list(heads), *(row.cells(heads, effects) for row, effects in folded(rows))]


def share_text(share: float) -> str:
    """Returns a share, 0 to 1, in %. Only exactly 0 and exactly 1 are shown as 0 % and 100 %."""
    if share <= 0.0 or share >= 1.0:
        return "0 %" if share <= 0.0 else "100 %"
    return f"{min(max(share * 100.0, 0.1), 99.9):.1f} %"


def range_cells(
    config: SignalConfig, smallest: float | None, mean: float | None, largest: float | None
) -> dict[str, str]:
    """Returns the cells min, mean and max: values of the statistic, or the levels of a driver, which have no mean."""
    unit = judged_unit(config)
    is_level = config.is_status and not config.is_template

    def text(value: float | None) -> str:
        if value is None:
            return "-"
        return Level(int(value)).name if is_level else with_unit(number_text(value), unit)

    return {"min": text(smallest), "mean": text(None if is_level else mean), "max": text(largest)}
