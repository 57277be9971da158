# `make gait` and `make test` set up what they need in .venv/ and leave it alone while it is up to date.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: gait paper test lint measure clean

gait: .venv/.installed
	$(BIN)/python experiments/gait_search.py

paper: .venv/.installed
	$(BIN)/python experiments/paper.py

test: .venv/.installed-test
	$(BIN)/python -m pytest --numprocesses auto --dist worksteal

lint: .venv/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Everything that the docs quote; more than an hour on 2 cores, which should have nothing else to do.
measure: .venv/.installed-test
	for script in error_bars stability equivalence stiff hard_cases gradients scaling; do $(BIN)/python experiments/$$script.py || exit 1; done
	$(BIN)/python experiments/work_precision.py --mujoco
	$(BIN)/python experiments/benchmark.py --mujoco
	$(BIN)/python experiments/update_docs.py

clean:
	rm -rf .venv .cache results build *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/.installed: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable .
	touch $@

.venv/.installed-test: .venv/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[test]'
	touch $@
