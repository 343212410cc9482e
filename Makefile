# Everything is set up from python3 alone: a virtual environment in .venv with the versions of constraints.txt.
PYTHON ?= python3
OUT ?= demo-out
VENV := .venv
BIN := $(VENV)/bin
INPUTS := pyproject.toml constraints.txt
PIP := PIP_CONSTRAINT=constraints.txt PIP_DISABLE_PIP_VERSION_CHECK=1 $(BIN)/python -m pip install --quiet

# Tests start some hundred processes: what one has compiled, the others read.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install install-dev install-clients demo bench test test-grid test-faults lint clean

help:
	@echo "make install          the commands kffa-offboard and sim-vehicle, in $(BIN)"
	@echo "make demo             fly: take off, pick up 5 kg, drop it, land; figure and table in $(OUT)"
	@echo "make test             ruff, mypy, import contracts, pytest"
	@echo "make test-grid        every other seed with both autopilots and both outputs: some minutes"
	@echo "make test-faults      three thousand random mixtures of faults in flight: six minutes on two cores"
	@echo "make lint             the same without pytest"
	@echo "make install-clients  the extras, too: campaigns, and MAVProxy and MAVSDK for the tests that fly the simulator with them (1 GB)"
	@echo "make bench            latency, replay, start-up, cost, jitter and batches of flights measured; benchmarks/results.json"
	@echo "make clean            remove $(VENV), caches and builds"

install: $(VENV)/.base
install-dev: $(VENV)/.dev
install-clients: $(VENV)/.clients

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "error: $(PYTHON) is `$(PYTHON) --version 2>&1`; Python 3.11 or newer is needed: make PYTHON=python3.12 ..." >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.base: $(INPUTS) | $(BIN)/python
	$(PIP) --editable .
	@touch $@

$(VENV)/.dev: $(INPUTS) | $(BIN)/python
	$(PIP) --editable '.[dev]'
	@touch $(VENV)/.base $@

$(VENV)/.clients: $(INPUTS) | $(BIN)/python
	$(PIP) --editable '.[dev,clients,campaign]'
	@touch $(VENV)/.base $(VENV)/.dev $@

demo: $(VENV)/.base
	$(BIN)/kffa-offboard demo --out $(OUT)

bench: $(VENV)/.base
	$(BIN)/python benchmarks/latency.py
	$(BIN)/python benchmarks/replay.py
	$(BIN)/python benchmarks/startup.py
	$(BIN)/python benchmarks/cost.py
	$(BIN)/python benchmarks/jitter.py
	$(BIN)/python benchmarks/fleet.py
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/scale.py

lint: $(VENV)/.dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

test: lint
	@$(BIN)/python -c 'import MAVProxy, mavsdk, pyarrow, joblib, distributed' 2>/dev/null || \
	  echo "note: an extra is not installed: tests with MAVProxy and MAVSDK, or of campaigns, are skipped (make install-clients)"
	$(BIN)/python -m pytest --numprocesses auto --dist worksteal

test-grid: $(VENV)/.dev
	$(BIN)/python -m pytest --numprocesses auto --dist worksteal -m grid --timeout 300 $$(grep -rlw mark.grid --include='*.py' tests)

test-faults: $(VENV)/.dev
	$(BIN)/python -m pytest --numprocesses auto --dist worksteal -m long_faults

clean:
	rm -rf $(VENV) build dist .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
