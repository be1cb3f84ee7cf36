"""The front command: measures, then prints one table.

    python -m benchmarks                    everything that can run here
    python -m benchmarks observe            one part of it

Exit code 1 when a requirement is missed.
"""

from __future__ import annotations

import argparse
import sys
from typing import Callable, Dict, Iterable, List

from benchmarks import observe_cost
from benchmarks.table import Row, table

PARTS: Dict[str, Callable[[], Iterable[Row]]] = {
    "observe": observe_cost.rows,
}


def main() -> int:
    """Runs the parts that were asked for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__.split("\n")[0])
    parser.add_argument("part", nargs="*", choices=[*PARTS, []], help=f"what to measure: {', '.join(PARTS)}")
    asked = parser.parse_args().part or list(PARTS)
    rows: List[Row] = []
    for part in asked:
        print(f"measuring {part} ...", file=sys.stderr, flush=True)
        rows.extend(PARTS[part]())
    print(table(rows))
    return 1 if any(row.verdict == "missed" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
