# `make race` and `make test` set everything up first; that takes no time where it is done.

PYTHON ?= python3
IN_WORKSPACE = . .venv/bin/activate &&
SET_UP = $(PYTHON) scripts/setup_workspace.py

# Started from a Python that has ROS wheels, make inherits its library path; ours sets its own.
ifdef _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
endif

# Where it is set, as in many containers, each process would compile all modules that it imports again.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup race test fuzz scenarios faults referee lint types view docs check-docs bench clean

# ARGS reach the command: make race ARGS="--seeds 20"
help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-11s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup:  ## install everything into .venv; does nothing where it is done
	@command -v $(PYTHON) >/dev/null || { echo "setup: Python is missing: install with" \
		"'sudo apt install python3 python3-venv python3-dev'." >&2; exit 2; }
	@$(SET_UP)

race: setup  ## fly one race in simulation; ARGS="--seeds 20" flies twenty
	@$(IN_WORKSPACE) swiftros race $(ARGS)

test: setup  ## run the tests, in two processes
	@$(IN_WORKSPACE) python -m pytest -n 2 --dist loadfile $(ARGS)

# INPUTS of each format: make fuzz INPUTS=1000; MSP gets 100 frames for each
INPUTS ?= 100000
fuzz: setup  ## draw and damage inputs for all parsers, 100,000 of each format: hours; ARGS=tests/fuzz/test_msp.py runs one
	@$(IN_WORKSPACE) SWIFT_FUZZ_INPUTS=$(INPUTS) python -m pytest -o faulthandler_timeout=0 $(or $(ARGS),tests/fuzz)

scenarios: setup  ## run the slow tests: each node killed and frozen in mid-race, some twenty races, sealed cases, planted effects
	@$(IN_WORKSPACE) python -m pytest -m slow $(ARGS)

# Draws that are flown already are kept; ARGS="--draws 1 --seed 137" flies one
faults: setup  ## fly races with faults drawn at random: 200 in lockstep, 200 in real time; hours, continues where it stopped
	@$(IN_WORKSPACE) swiftros faults --draws 400 $(ARGS)

lint: setup  ## check the code with ruff: rules and format
	@$(IN_WORKSPACE) ruff check . && $(IN_WORKSPACE) ruff format --check .

types: setup  ## check the types with basedpyright
	@$(SET_UP) types
	@$(IN_WORKSPACE) basedpyright

view: setup  ## install the Rerun viewer for `swiftros view`, 500 MB
	@$(SET_UP) view

docs: setup  ## generate the pages of topics and effects, build the pages into site/
	@$(SET_UP) docs
	@$(IN_WORKSPACE) python scripts/generate_docs.py && $(IN_WORKSPACE) NO_MKDOCS_2_WARNING=1 mkdocs build --strict --quiet

check-docs: setup  ## run every command of README and docs in a clean clone; ARGS=FOLDER names the clone
	@$(IN_WORKSPACE) python scripts/run_documented_commands.py $(ARGS)

bench: setup  ## measure latencies, CPU time and the speed of the physics
	@$(IN_WORKSPACE) swiftros bench $(ARGS)

# Other seeds: ARGS="--seed 7000"; the table of the cases scored so far: ARGS=--score
referee: setup  ## run the gap tool on all sealed cases: hours, continues where it stopped
	@$(IN_WORKSPACE) swiftros gap-referee --batch full --seed 1000 $(ARGS)

clean:  ## remove the environment and everything that was built
	rm -rf .venv build install log site
