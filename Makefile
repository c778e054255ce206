# Two commands: `make tune` runs a small real tuning campaign, `make test` runs the tests.
# Both set everything up first.   PYTHON=... chooses the interpreter, VENV=... the environment's place.
VENV ?= .venv
RUN ?= tune
BIN = $(VENV)/bin

.PHONY: tune tune-photographs test fast-test lint docs setup wheel-test clean
.DEFAULT_GOAL := help

help:
	@echo "make tune        set up, tune the gate, its weights and the pool on simulated missions, compare with the paper's"
	@echo "                 strategies; writes runs/$(RUN)/report.html"
	@echo "make tune-photographs  set up, search the fewest photographs with an F-score of 98 %"
	@echo "make test        set up, check the code, run all tests"
	@echo "make fast-test   the tests that take less than a second or two each"
	@echo "make fuzz        MINUTES=5 of damaged files through every parser, and the command line; runs/fuzz/fuzz.csv"
	@echo "make faults      MINUTES=5 or COUNT=1000 of kills and failing disks in campaigns; runs/faults/faults.csv"
	@echo "make lint        ruff, mypy, import-linter"
	@echo "make docs        build the documentation into site/"
	@echo "make wheel-test  build sdist and wheel; run the three jobs and every command of the pages from the wheel"

setup: $(VENV)/.ready

$(VENV)/.ready: pyproject.toml constraints.txt .ci/setup
	@GOAL=$(MAKECMDGOALS) .ci/setup $(VENV)

tune: setup
	$(BIN)/gatetune campaign run --quick --name $(RUN) --resume-if-present

tune-photographs: setup
	$(BIN)/gatetune campaign run --name $(RUN)-photographs --resume-if-present --space photographs \
	    --objective 'photographs@f_score>=98' --budget 36 --rock slab --rock vesicular --rock cavern \
	    --set dense.agreeing_views=3
	$(BIN)/gatetune mission view runs/$(RUN)-photographs

test: setup lint
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2

fast-test: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 -m "not slow"

fuzz: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m research.fuzz

faults: setup
	$(BIN)/python -m research.faults

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python docs/structure.py | grep "^large:" || true

docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

wheel-test: setup
	OMP_NUM_THREADS=1 .ci/with-wheel $(VENV) $(BIN)/python -m pytest -n 2 tests/street

clean:
	rm -rf $(VENV) .peers
