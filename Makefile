# Everything lives in .venv; all it takes is git, make and Python 3.11 or newer with venv.
#
#   make run       install, then sail the ferry's mission: results/mission-averaged/
#   make test      install, then lint, contracts, types and tests (under 20 minutes on two cores)
#   make full      what is too slow for `make test`
#   make install   only install; ends with the kernels compiled into the user's cache
#   make lint      ruff, import-linter, pyright

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
WORKERS ?= 2

.PHONY: run install install-test test full lint format clean

run: install
	$(BIN)/shipgrid run

install: $(VENV)/.installed
	$(BIN)/shipgrid warm

install-test: $(VENV)/.installed-test

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
	$(BIN)/python -m pytest --numprocesses $(WORKERS) --dist loadscope -m "not full and not realtime"

# With the mission's first half at 30 us (minutes).
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
