"""Reads the lists of requirements from setup.py, which is the only place that holds them."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any, List

ROOT = Path(__file__).resolve().parents[2]


def runtime_requirements() -> List[str]:
    """Returns the packages that the monitor needs."""
    requirements: List[str] = _setup_argument("install_requires")
    return requirements


def test_requirements() -> List[str]:
    """Returns the packages that the tests need in addition."""
    requirements: List[str] = _setup_argument("extras_require")["test"]
    return requirements


def _setup_argument(name: str) -> Any:
    for node in ast.walk(ast.parse((ROOT / "setup.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.keyword) and node.arg == name:
            return ast.literal_eval(node.value)
    raise AssertionError(f"setup.py has no {name}")
