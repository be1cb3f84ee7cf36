# make run: the monitor on this machine, simulated robot, no ROS.   make test: every test that this machine can run.
# make bench: what it costs, beside bare peers, in one run.   make lint: formatter, linter, types, imports.
# All set up what is missing under .venv/. ARGS goes to the command: make run ARGS=--json, make test ARGS="ros1 ros2".
PYTHON ?= python3
.PHONY: run test bench lint

run:
	@$(PYTHON) tests/environments.py
	@.venv/run/bin/python -m robot_health_monitor run $(ARGS)

test:
	@$(PYTHON) tests/run_all.py $(ARGS)

bench:
	@$(PYTHON) -m benchmarks $(ARGS)

lint:
	@$(PYTHON) tests/run_all.py lint
