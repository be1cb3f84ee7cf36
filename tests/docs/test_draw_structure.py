"""docs/structure.svg shows the folders' imports and the way of a sample as they are in the code."""

from __future__ import annotations

import runpy
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[2] / "docs"
SCRIPT: dict[str, Any] = runpy.run_path(str(DOCS / "draw_structure.py"))


def test_the_picture_is_the_one_that_the_script_draws() -> None:
    picture = (DOCS / "structure.svg").read_text(encoding="utf-8")
    assert picture == SCRIPT["picture"](), "run: python docs/draw_structure.py"
    assert ElementTree.fromstring(picture).tag == "{http://www.w3.org/2000/svg}svg"


def test_core_imports_no_folder_and_the_top_imports_all() -> None:
    imported = SCRIPT["folders_imported"]
    assert imported("core") == set()
    assert imported("runtime") == {"core"}
    assert imported("cli") == {
        "core", "runtime", "ros1", "ros2", "rosbridge", "foxglove", "recordings", "ops"
    }  # fmt: skip


def test_the_way_of_a_sample_passes_the_steps_of_the_rules() -> None:
    files = [file for file, _ in SCRIPT["way_of_a_sample"]()]
    expected = [
        "core/nodes/alert_system.py",
        "core/judge/monitor.py",
        "core/judge/signal_monitor.py",
        "core/judge/window.py",
    ]
    assert [file for file in files if file in expected] == expected
    assert "core/nodes/outlets.py" in files[files.index("core/judge/wording.py") :]
