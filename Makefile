# `make run` and `make test` set up all they need: only Python 3.11 or later, pip and make are assumed.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
# One process more than there are cores: tests of the daemon wait for clocks and lines.
WORKERS := $(shell echo $$(( $$(getconf _NPROCESSORS_ONLN || echo 2) + 1 )))
PYTEST := $(BIN)/python -m pytest -q --numprocesses $(WORKERS) --maxprocesses 5 --dist worksteal

.PHONY: run test test-all mutants check faults fuzz week year evaluate bench clean

run: $(READY)
	$(BIN)/python -m stillcal.replay.trials.demo.tour

test: $(READY)
	$(PYTEST) -m 'not slow'

test-all: $(READY)
	$(PYTEST)

mutants: $(READY)
	$(BIN)/python -m pip install --quiet --editable '.[mutation]'
	$(BIN)/python -m tests.mutation $(MUTANTS)

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# FAULTS=--part=kills for one part of it.
faults: $(READY)
	$(BIN)/python -m stillcal.replay.trials.faults $(FAULTS)

# Ten minutes for each parser; FUZZ=--seconds=60 for less.
fuzz: $(READY)
	$(BIN)/python -m tests.fuzz $(FUZZ)

week: $(READY)
	$(BIN)/python -m stillcal.replay.trials.week

year: $(READY)
	$(BIN)/python -m stillcal.replay.trials.year

bench: $(READY)
	$(BIN)/python -m pip install --quiet --editable '.[benchmarks]'
	$(BIN)/python benchmarks

evaluate: $(READY)
	$(BIN)/stillcal evaluate --jobs 2

$(READY): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "stillcal needs Python 3.11 or later: make PYTHON=python3.11 (or newer) ..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) build dist out *.egg-info
