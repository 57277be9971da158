# Every command sets up what it needs in .venv/, and leaves that alone while it is up to date.
PYTHON ?= python3
BIN := .venv/bin
TESTS := $(BIN)/python -m pytest --numprocesses auto --dist worksteal

.PHONY: install gait paper check test lint bench measure clean

# The library and its command, .venv/bin/jaxgrity.
install: .venv/.installed

# Evolves, polishes and verifies a rolling gait: results/gait_search/index.html.
gait: .venv/.installed
	$(BIN)/python experiments/gait_search.py

# Checks the claims of the paper behind the project: docs/paper.md.
paper: .venv/.installed
	$(BIN)/python experiments/paper.py

# While one works: everything but the slow tests.
check: lint
	$(TESTS) -m "not slow"

test: .venv/.installed-test
	$(TESTS)

lint: .venv/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --cache-dir .cache/import_linter --no-logo
	$(BIN)/mypy

# How fast this machine is, in about two minutes; LIMIT=FOLDER measures the C programs there too.
bench: .venv/.installed
	$(BIN)/python experiments/measurements/bench.py $(if $(LIMIT),--limit $(LIMIT))

# Everything that the docs quote; more than an hour on 2 cores, which should have nothing else to do.
MEASUREMENTS := error_bars stability equivalence stiff hard_cases gradients scaling
measure: .venv/.installed-test
	for name in $(MEASUREMENTS); do $(BIN)/python experiments/measurements/$$name.py || exit 1; done
	$(BIN)/python experiments/measurements/work_precision.py --mujoco
	$(BIN)/python experiments/measurements/benchmark.py --mujoco
	$(BIN)/python experiments/docs_tables/update_docs.py

clean:
	rm -rf .venv .cache results build dist *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/.installed: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable .
	touch $@

.venv/.installed-test: .venv/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[test]'
	touch $@
