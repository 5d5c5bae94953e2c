# Python 3.11 or newer and make are all it takes: the first target made sets up $(VENV), later ones find it ready.

VENV ?= .venv
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := $(VENV)/bin

# One thread to a process: the tests and the benchmarks spread over the cores by themselves.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: demo test bench lint format clean
.DEFAULT_GOAL := demo

# Plans the basic climb, checks the plan from its file alone, and leaves plan and pictures in out/basic.
demo: $(VENV)/.ready
	$(BIN)/climber solve scenarios/basic.yaml --out out/basic
	$(BIN)/climber verify out/basic/plan.json

test: $(VENV)/.ready-test
	$(BIN)/python -m pytest --numprocesses auto --dist worksteal

bench: $(VENV)/.ready-bench
	$(BIN)/python -m benchmarks

lint: $(VENV)/.ready-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.ready-test
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf out dist .mypy_cache .pytest_cache .ruff_cache .hypothesis .benchmarks

$(VENV)/.ready: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "climber needs Python 3.11 or newer")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/.ready-%: $(VENV)/.ready
	$(BIN)/python -m pip install --quiet --editable '.[$*]'
	touch $@

.PRECIOUS: $(VENV)/.ready-%
