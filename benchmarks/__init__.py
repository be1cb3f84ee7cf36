"""Benchmarks of the monitor, compared with similar programs in the same run: `python -m benchmarks`."""
