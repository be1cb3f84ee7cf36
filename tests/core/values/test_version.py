from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from robot_health_monitor.core.values.version import package_version


def test_the_version_is_that_of_package_xml() -> None:
    manifest = Path(__file__).resolve().parents[3] / "package.xml"
    assert package_version() == ElementTree.parse(manifest).findtext("version")
