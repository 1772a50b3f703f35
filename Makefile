# Everything lives in .venv, but for ngspice and chromium; all it takes is git, make and Python 3.11 or newer with venv.
#
#   make run       install, then sail the ferry's mission: results/mission-averaged/
#   make test      install, then lint, contracts, types and tests (under 20 minutes on two cores)
#   make full      what is too slow for `make test`
#   make install   only install; ends with the kernels compiled into the user's cache
#   make ngspice   the system's ngspice, with which the tests compare; part of `make test` where apt-get may be used
#   make chromium  the system's Chromium, in which the tests look at reports; likewise
#   make lint      ruff, import-linter, pyright

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
WORKERS ?= 2
# small matrices only: threads of the linear algebra library would wait for each other beside the workers
export OMP_NUM_THREADS ?= 1

.PHONY: run install install-test ngspice chromium test full lint format clean

run: install
	$(BIN)/shipgrid run

install: $(VENV)/.installed
	$(BIN)/shipgrid warm

install-test: $(VENV)/.installed-test
	@command -v ngspice > /dev/null || $(MAKE) --no-print-directory ngspice
	@command -v chromium > /dev/null || command -v chromium-browser > /dev/null || command -v google-chrome > /dev/null || \
		$(MAKE) --no-print-directory chromium

# The tests compare circuits with ngspice and look at reports in chromium, system packages; without them they fail, and say
# this again.
ngspice chromium:
	@if [ "$$(id -u)" = 0 ]; then apt="apt-get"; else apt="sudo -n apt-get"; fi; \
		{ $$apt update -qq && $$apt install --yes -qq $@ > /dev/null && command -v $@; } || \
		echo "$@ is missing and could not be installed: as root, apt-get install $@; tests that need it will fail"

$(VENV)/.created:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "shipgrid needs Python 3.11 or newer; try: make PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/.installed: $(VENV)/.created lock/requirements.txt pyproject.toml
	$(PIP) install --quiet --requirement lock/requirements.txt
	$(PIP) install --quiet --no-deps --editable .
	touch $@

$(VENV)/.installed-test: $(VENV)/.installed lock/requirements-test.txt
	$(PIP) install --quiet --requirement lock/requirements-test.txt
	touch $@

test: install install-test lint
	$(BIN)/python -m pytest --numprocesses $(WORKERS) --dist loadfile -m "not full and not realtime"

# With the mission at 30 us, averaged in half and at switching fidelity whole (tens of minutes).
full: install install-test lint
	$(BIN)/python -m pytest

lint: install-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache
	$(BIN)/pyright

format: install-test
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) build dist .pytest_cache .ruff_cache .hypothesis
