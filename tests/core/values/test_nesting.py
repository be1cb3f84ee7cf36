"""JSON from outside is refused where it is nested too deep, before Python's own limit of recursion is reached."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core.values import read_json, shallow_json

TREES = st.recursive(
    st.none() | st.text(alphabet='[]{}"\\a', max_size=6),
    lambda children: st.lists(children, max_size=3) | st.dictionaries(st.text(alphabet='["\\', max_size=3), children),
    max_leaves=30,
)


def depth(tree: object) -> int:
    """The referee: the depth of what was parsed."""
    children = tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else None
    return 0 if children is None else 1 + max(map(depth, children), default=0)


@given(TREES)
def test_the_depth_is_that_of_the_parsed_value(tree: object) -> None:
    text = json.dumps(tree)
    levels = depth(tree)
    assert shallow_json(text, levels) == text
    if levels:
        wide = json.dumps([tree] * 3)  # three times, so that it has more brackets than levels
        assert shallow_json(wide, levels + 1) == wide
        with pytest.raises(RecursionError, match=f"nested more than {levels} levels deep"):
            shallow_json(wide, levels)


@pytest.mark.parametrize(
    "text",
    ["[" * 65, "[" * 1_000_000, '{"a":[' * 500_000, "[" * 65 + "]" * 65, '{"a":' * 65 + "1", "]" * 99 + "[" * 99],
    ids=lambda text: text[:8],
)
def test_what_is_too_deep_is_refused_whether_it_ends_or_not(text: str) -> None:
    with pytest.raises(RecursionError, match="nested more than 64 levels deep"):
        shallow_json(text)
    for form in (text, text.encode()):
        with pytest.raises(ValueError, match="nested more than 64 levels deep"):
            read_json(form)


@pytest.mark.parametrize("text", [None, 5, b"\xff", "", "nul"])
def test_what_is_no_json_is_a_value_error(text: object) -> None:
    with pytest.raises(ValueError):
        read_json(text)


def test_a_text_and_its_bytes_have_the_same_value() -> None:
    assert read_json('{"\u00e4": [1]}') == read_json('{"\u00e4": [1]}'.encode()) == {"\u00e4": [1]}


@pytest.mark.parametrize("text", ['[{"a": [1, 2]}, {"b": [' * 20, "[[], [}" * 40, '{"a": "' + "[{" * 99])
def test_what_ends_too_early_is_no_matter_of_depth(text: str) -> None:
    with pytest.raises(ValueError):
        read_json(text)


def test_a_deep_message_never_ends_the_process() -> None:
    """Python 3.8 aborts where garbage with a finalizer is collected at the deepest point: every point is tried."""
    program = """
import gc, sys
from robot_health_monitor.core.values import read_json

class Finalized:
    def __del__(self):
        def call(depth):
            if depth: call(depth - 1)
        call(20)

def leave_garbage():
    made = Finalized()
    made.itself = made

sys.unraisablehook = lambda unraisable: None
for threshold in range(700, 1100):
    gc.collect()
    gc.set_threshold(threshold)
    leave_garbage()
    try:
        read_json("[" * 3_000)
    except ValueError as error:
        assert str(error) == "nested more than 64 levels deep"
print("alive")
"""
    root = Path(__file__).resolve().parents[3]
    ended = subprocess.run([sys.executable, "-c", program], cwd=root, capture_output=True, text=True, timeout=120)
    assert (ended.stdout, ended.returncode) == ("alive\n", 0), ended.stderr[-1000:]
