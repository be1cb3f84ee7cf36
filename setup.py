"""Builds the package for pip and, as ament_python, for ROS 2. ROS 1 builds with CMakeLists.txt."""

import re
import sys
from glob import glob
from pathlib import Path
from xml.etree import ElementTree

from setuptools import setup
from setuptools.command.install import install

NAME = "robot_health_monitor"
FOLDERS = ["core", "runtime", "ros1", "ros2", "rosbridge", "foxglove", "recordings", "ops", "cli"]
"""Top-level folders that are packages below the root package; CMakeLists.txt has the same list."""


PACKAGES = [
    package.parent.as_posix().replace("/", ".")
    for folder in ["", *FOLDERS]  # links, which rglob does not follow
    for package in sorted(Path(NAME, folder).rglob("__init__.py"))
]

manifest = ElementTree.parse("package.xml").getroot()


def text(tag):
    """Returns the text of an element of package.xml, the one place that holds version, licence and maintainer."""
    return manifest.find(tag).text


urls = {url.get("type"): url.text for url in manifest.findall("url")}


def readme():
    """Returns the README for a package index, where links into the repository need its address."""
    if not Path("README.md").exists():
        return ""
    found = Path("README.md").read_text(encoding="utf-8")
    found = re.sub(r"(!\[[^]]*\])\((?=docs/)", r"\1(" + urls["repository"] + "/raw/HEAD/", found)
    return re.sub(r"\]\((?=[\w/]+\.\w+[)#])", "](" + urls["repository"] + "/blob/HEAD/", found)


data_files = [
    ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
    ("share/" + NAME, ["package.xml"]),
    ("share/" + NAME + "/launch", sorted(glob("launch/*.launch") + glob("launch/*.launch.py"))),
    ("share/" + NAME + "/config", sorted(glob("config/*.yaml"))),
    ("share/" + NAME + "/systemd", ["resource/robot-health.service", "resource/robot-health@.service"]),
]


class InstallForRos(install):
    """Puts the commands where `ros2 run` looks for them, although bloom's debian/rules asks for bin/."""

    def finalize_options(self):
        self.install_scripts = "$base/lib/" + NAME
        super().finalize_options()


# colcon and Debian's tools run this file themselves; pip runs it through the build backend and installs all commands
# into bin/. For ROS, bin/ gets a script that forwards to `robot-health`.
commands = {}
if "setuptools.build_meta" not in sys.modules:
    data_files.append(("bin", ["resource/robot-health"]))
    commands = {"install": InstallForRos}

setup(
    name=NAME,
    version=text("version"),
    description=text("description"),
    long_description=readme(),
    long_description_content_type="text/markdown",
    license=text("license"),
    url=urls["website"],
    project_urls={"Repository": urls["repository"], "Issues": urls["bugtracker"]},
    keywords="robotics ROS monitoring diagnostics rosbridge alerts",
    classifiers=[
        "Environment :: Console",
        "Intended Audience :: Developers",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Topic :: Scientific/Engineering",
        "Topic :: System :: Monitoring",
        "Typing :: Typed",
    ],
    maintainer=text("maintainer"),
    maintainer_email=manifest.find("maintainer").get("email"),
    python_requires=">=3.8",
    packages=sorted(set(PACKAGES)),
    package_data={
        NAME: ["py.typed"],
        NAME + ".ops.export": ["files/*.*", "files/*/*.*"],
        NAME + ".ops.plot": ["*.css", "*.js"],
        NAME + ".ops.report": ["*.css", "*.html", "*.js"],
        NAME + ".ops.web.page": ["*.css", "*.html", "*.js", "*.svg"],
    },
    data_files=data_files,
    cmdclass=commands,
    install_requires=["PyYAML>=5.3", "aiohttp>=3.6", "cbor2", "psutil>=5.5", "rich>=10.16"],
    extras_require={
        "apprise": ["apprise"],
        "recordings": ["lz4>=3.1", "mcap>=1.1", "rosbags>=0.9.23", "zstandard>=0.18"],
        "test": ["hypothesis>=6.82", "numpy", "prometheus-client>=0.7", "pyte", "pytest>=7.2", "trustme"],
    },
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "robot-health = robot_health_monitor.__main__:main",
            "battery_sensor = robot_health_monitor.cli.ros2_executables:battery_sensor",
            "aggregator = robot_health_monitor.cli.ros2_executables:aggregator",
            "alert_system = robot_health_monitor.cli.ros2_executables:alert_system",
            "health_monitor = robot_health_monitor.cli.ros2_executables:health_monitor",
        ],
    },
)
