# make run     the monitor on this machine: simulated robot, no ROS
# make test    every test that this machine can run
# make lint    linter, formatter, types, import rules
# make docs    the documentation site, in build/docs/html
# make bench   what it costs, beside bare peers
# make soak    two thousand kills -9, which must lose nothing; ten minutes of clients: memory and threads must stay flat
# make fuzz    random input to everything that takes input, for one minute, twenty times the random examples of the tests,
#              and 100,000 timelines of silence
# make dist    the wheel and the source distribution of the last commit, in dist/
# make deb     the Debian packages, in dist/debian; each is installed, started and purged in a new root (as root)
# make release VERSION=1.0.0   everything up to the upload: version, changelog, tag, every test, packages
# make check-release VERSION=1.0.0   whether the commit that is checked out may be published: the release workflow asks
#
# Each sets up what it needs under .venv/. ARGS goes to the command: make run ARGS=--json, make test ARGS="ros1 fleets",
# make test ARGS="core -- -k battery" (sessions of noxfile.py, then options of pytest).

PYTHON ?= python3
# Sessions at the same time, for two cores: tests often wait for another process.
JOBS ?= 12
NOX = .venv/nox/bin/nox
# virtualenv 20 is the last version that makes environments of Python 3.8.
NOX_REQUIREMENTS = nox 'virtualenv<21' uv
PIP_INSTALL = bin/python -m pip install --quiet --disable-pip-version-check

.PHONY: run test lint docs bench soak fuzz dist deb release check-release

run: .venv/run/installed
	@.venv/run/bin/robot-health run $(ARGS)

test: .venv/nox/installed
	@rm -rf .venv/results; mkdir -p .venv/results
	@NOX_PARALLEL=$(JOBS) $(NOX) --report .venv/results/nox.json $(if $(ARGS),--session $(ARGS)); status=$$?; \
	 $(PYTHON) tests/report.py .venv/results && exit $$status

lint: .venv/nox/installed
	@$(NOX) --session lint types

docs: .venv/nox/installed
	@$(NOX) --session docs
	@echo "build/docs/html/index.html; addresses that were not checked: build/docs/external_links.txt" >&2

bench: .venv/nox/installed
	@$(NOX) --install-only --session ros1 ros2
	@$(NOX) --session bench -- $(ARGS)

soak fuzz dist deb: .venv/nox/installed
	@$(NOX) --session $@ -- $(ARGS)

release: .venv/nox/installed
	@$(NOX) --session release -- $(VERSION)

check-release: .venv/nox/installed
	@$(NOX) --session release -- --check $(VERSION)

.venv/run/installed: setup.py package.xml | .venv/run/bin/pip
	@echo "installing the requirements into .venv/run" >&2
	@.venv/run/$(PIP_INSTALL) --editable .
	@touch $@

.venv/nox/installed: Makefile | .venv/nox/bin/pip
	@.venv/nox/$(PIP_INSTALL) $(NOX_REQUIREMENTS)
	@touch $@

# Debian's Python needs a package for this, which root can install.
.venv/%/bin/pip:
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || test "$$(id -u)" != 0 || \
	 { apt-get -qq update; apt-get -qq install -y --no-install-recommends python3-venv; } >/dev/null
	@$(PYTHON) -m venv .venv/$*
