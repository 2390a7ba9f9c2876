PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# A looser pin that pip resolves itself may pull gigabytes of CUDA
TORCH := torch==2.13.0
# Assertions are rewritten once, not by every worker of every run
export PYTHONDONTWRITEBYTECODE :=

.PHONY: install run test test-all check bench docs clean

install: $(STAMP)  ## the virtual environment, with heft in it

run: $(STAMP)  ## the main job: the comparison on the paper's objects, in the ideal world and in a lab
	$(BIN)/heft run blocks
	$(BIN)/heft run lab

test: $(STAMP)  ## quick tests, on two cores
	OMP_NUM_THREADS=1 $(BIN)/pytest -m "not slow" --numprocesses 2 --dist worksteal

test-all: $(STAMP)  ## all tests
	$(BIN)/pytest

check: $(STAMP)  ## format, lint, types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright

bench: $(STAMP)  ## speed and memory, as ratios measured side by side, and the core-seconds of the main job
	$(BIN)/python bench/bench.py
	$(BIN)/python bench/whole_run.py

docs: $(STAMP)  ## the documentation as a site, in site/; a broken link is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

clean:
	rm -rf $(VENV) results dist build site .pytest_cache .ruff_cache .hypothesis

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet --require-hashes --requirement constraints.txt
	$(BIN)/pip install --quiet $(TORCH)
	$(BIN)/pip install --quiet --no-deps --no-build-isolation --editable .
	touch $@
