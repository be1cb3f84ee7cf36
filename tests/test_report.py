"""The end of `make test`: what failed is named, also where a session ended without results."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

REPORT = Path(__file__).resolve().parent / "report.py"
CASES = """<testsuites><testsuite>
<testcase classname="tests.a" name="test_passes"/>
<testcase classname="tests.a" name="test_fails"><failure message="assert 1 == 2&#10;more"/></testcase>
<testcase classname="tests.a" name="test_breaks"><error/></testcase>
<testcase classname="tests.a" name="test_waits"><skipped message="no robot"/></testcase>
</testsuite></testsuites>"""


def test_what_failed_is_named(tmp_path: Path) -> None:
    results = {"core": "failed", "services": "failed", "lint": "success", "ros1": "skipped"}
    sessions = [{"signatures": [name], "result": each, "reason": "no ROS 1"} for name, each in results.items()]
    (tmp_path / "nox.json").write_text(json.dumps({"sessions": sessions}))
    (tmp_path / "core.xml").write_text(CASES)
    (tmp_path / "services.exit_code").write_text("-6")
    ended = subprocess.run([sys.executable, REPORT, tmp_path], stdout=subprocess.PIPE, text=True, timeout=60)
    assert ended.returncode == 1
    assert ended.stdout.splitlines()[7:] == [
        "Not run on this machine:",
        "  core: 1 skipped: no robot",
        "  ros1: no ROS 1",
        "",
        "Failed:",
        "  core: tests.a::test_fails: assert 1 == 2",
        "  core: tests.a::test_breaks: error",
        "  services: outside its tests: pytest ended with -6; its output is above",
        "",
        "2 passed, 3 failed, 1 skipped",
    ]
