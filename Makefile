# `make help` says what there is.  The first call of anything builds the virtual environment.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
PYTEST := $(BIN)/python -m pytest
COVERED := $(PYTEST) --cov --cov-append --cov-report= --cov-fail-under=0

# Everything stays on loopback, and each run of a test is the same run.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export HYPOTHESIS_PROFILE ?= ci

# Coverage cannot see compiled kernels, so their tests run once more as plain Python, without what
# takes long there or needs ROS: evidence is what part 1 says, part 3 shows that lines are reached.
KERNELS := test/test_rotations.py test/calibration/test_preintegration.py test/synchronization \
	test/fusion test/odometry test/pipeline/test_drift.py
# What is plain numpy anyhow.
NO_KERNELS := $(foreach name,filter_bank local_filters masters prefilters,\
	--ignore=test/fusion/test_$(name).py) --ignore=test/synchronization/test_delay.py

# Judges when messages come, so nothing else may run beside it.
DRILL := test/nodes/test_fault_drill.py

# What builds the sketch of firmware/ and the board that it is tested on.
FIRMWARE_TOOLS := make gcc g++ libc6-dev gcc-avr avr-libc binutils-avr arduino-core-avr \
	libsimavr-dev arduino-builder

.DEFAULT_GOAL := help
.PHONY: help install kernels demo test statistics check static bench clean firmware-tools

help:  ## say what there is
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 16

install: kernels  ## build the virtual environment in .venv

demo: $(READY)  ## eight emulated IMUs become one: live table, HTML report
	$(BIN)/multiimu demo

# Never fails: where it cannot install, the tests of the firmware say that they are skipped.
firmware-tools:  ## the toolchain of the firmware's tests, where apt-get may be used
	@{ command -v avr-g++ && command -v arduino-builder && command -v g++ && \
		test -e /usr/include/simavr/sim_avr.h; } >/dev/null || \
	{ test "$$(id -u)" = 0 && command -v apt-get >/dev/null && apt-get update -qq && \
		DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
		$(FIRMWARE_TOOLS) >/dev/null; } || \
	echo 'The tests of the firmware will be skipped: apt-get install $(FIRMWARE_TOOLS)'

test: firmware-tools  ## everything but statistics: linters, types, imports, tests with coverage
	@$(MAKE) --no-print-directory -j 2 -O static kernels
	@rm -f .coverage
	@echo '== 1/3 core, compiled, two at a time'
	$(COVERED) -n 2 --dist worksteal -m 'not ros and not long'
	@echo '== 2/3 rim: real nodes and processes that mostly wait, each third in a domain of its own'
	$(COVERED) -n 3 --dist loadfile -m ros --ignore=test/firmware --ignore=$(DRILL)
	@echo '== 2/3 rim: faults in real time, alone, for what is judged is when messages come'
	$(COVERED) -m ros $(DRILL)
	@echo '== 2/3 rim: the board in real time, which takes what it needs of the processors'
	$(COVERED) -n 2 --dist loadfile -m ros test/firmware
	@echo '== 3/3 kernels as plain Python, for coverage'
	MULTIIMU_COMPILED=0 $(COVERED) -n 2 --dist worksteal \
		-m 'not ros and not slow and not long and not realdata and not compiled' $(KERNELS) $(NO_KERNELS)
	$(BIN)/python -m coverage report --skip-covered

statistics: kernels  ## what it takes many runs to tell: bounds, rates of error, honest sigmas
	$(PYTEST) -n 2 --dist worksteal -m long

check: static kernels  ## the four of pre-commit, with the quick tests only
	$(PYTEST) -n 2 -m 'not ros and not slow and not long and not realdata'

static: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

# Before two workers, or four nodes, compile the same kernels at once.
kernels: $(READY)
	@echo 'Compiling the kernels, if they are new to this machine ...'
	@$(BIN)/python examples/pipeline_in_a_loop.py & first=$$!; \
		$(BIN)/python examples/calibration.py && wait $$first

bench: $(READY)  ## microseconds per fused frame; latency and CPU of the live graph
	$(BIN)/multiimu bench

clean:  ## remove the virtual environment and everything that was built
	rm -rf $(VENV) .venv-312 build install log out *.egg-info .coverage .pytest_cache \
		.mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

$(READY): requirements.txt requirements-dev.txt setup.py
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' || \
		{ echo 'Python 3.11 or 3.12 is needed: say `make PYTHON=/path/to/python3.12`.'; exit 1; }
	@$(PYTHON) -m venv $(VENV) || \
		{ echo 'Install the venv module: `apt-get install python3-venv`.'; exit 1; }
	$(BIN)/python -m pip install -qq -r requirements-dev.txt
	$(BIN)/python -m pip install -qq --no-build-isolation --no-deps --editable .
	@touch $@
