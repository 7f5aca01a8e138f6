# What a newcomer runs: demo, test. What a contributor runs besides: lint, fuzz, bench.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CAPTURE := captures/mks_rs485.log
SECONDS ?= 120
JOBS ?= 2

.PHONY: demo test oldest lint fuzz bench clean

demo: $(VENV)/.installed
	@rm -rf demo && mkdir demo
	@echo '$$ servotap decode $(CAPTURE) -o demo/'
	@$(BIN)/servotap decode $(CAPTURE) -o demo/
	@echo
	@echo '$$ servotap show demo/$(notdir $(CAPTURE)).mcap --limit 12'
	@$(BIN)/servotap show demo/$(notdir $(CAPTURE)).mcap --limit 12
	@echo
	@echo 'Three commands to try next:'
	@echo '  $(BIN)/servotap explain "FA 01 F6 01 40 02 34"'
	@echo '  $(BIN)/servotap show captures/mks_can.asc --filter "findings != []"'
	@echo '  $(BIN)/servotap catalogue --dialect mks-can run_speed'

# Three workers, for many tests wait for real processes and ports. What one has compiled the others take, and the next run.
test: $(VENV)/.test
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 3 --dist worksteal

# The terminal view as the oldest Textual that pyproject.toml allows draws it; `test` takes the newest.
oldest: $(VENV)/.oldest
	PYTHONPATH=$(VENV)/oldest $(BIN)/python -m pytest -q tests/view/test_capture_view.py

$(VENV)/.oldest: $(VENV)/.test
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --target $(VENV)/oldest textual==3.0.0
	@touch $@

lint: $(VENV)/.lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# By the clock: make fuzz SECONDS=7200. `python -m tests.fuzz --help` tells how to repeat one input, and of coverage.
fuzz: $(VENV)/.test
	$(BIN)/python -m tests.fuzz --seconds $(SECONDS) --jobs $(JOBS)

bench: $(VENV)/.bench
	$(BIN)/python benchmarks/run.py

# Debian puts ensurepip into a package of its own; without it venv fails half-way and leaves a folder behind.
$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or newer is needed; $(PYTHON) is $$($(PYTHON) --version)"; exit 1; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || \
	  { echo "Python's venv is not complete here. Install it with: sudo apt install python3-venv"; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

$(VENV)/.test: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test]'
	@touch $@ $(VENV)/.installed

$(VENV)/.lint: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test,lint]'
	@touch $@ $(VENV)/.installed

$(VENV)/.bench: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test,bench]'
	@touch $@ $(VENV)/.installed

clean:
	rm -rf $(VENV) demo
