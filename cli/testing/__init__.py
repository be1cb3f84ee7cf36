"""Unit tests of a thresholds.yaml, and how a past alert becomes one."""
