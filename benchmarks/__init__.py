"""Benchmarks of the monitor, compared with similar programs in the same run: `python -m benchmarks`."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # for harness
