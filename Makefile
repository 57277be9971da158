# Every command sets up what it needs in .venv/, and leaves that alone while it is up to date.
PYTHON ?= python3
BIN := .venv/bin
TESTS := $(BIN)/python -m pytest --numprocesses auto --dist worksteal

.PHONY: install gait explore paper docs check test verify lint bench conformance validate measure clean

# The library and its command, .venv/bin/jaxgrity.
install: .venv/.installed

# Evolves, polishes and verifies a rolling gait: results/gait_search/index.html.
gait: .venv/.installed
	$(BIN)/python experiments/gait_search.py

# A page on this machine whose sliders change a robot and its gait; SCENE=NAME or a scene file.
explore: .venv/.installed
	$(BIN)/jaxgrity explore $(SCENE)

# Checks the claims of the paper behind the project: docs/paper.md.
paper: .venv/.installed
	$(BIN)/python experiments/paper.py

# The documentation as a site, without a network but for what has to be installed: build/site/index.html.
docs: .venv/.installed-docs
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet -b html -c docs --doctree-dir .cache/doctrees . build/site
	@echo "open build/site/index.html in a browser"

# While one works: everything but the slow tests.
check: lint
	$(TESTS) -m "not slow and not campaign"

# All that shows that the product is right.
test: .venv/.installed-test
	$(TESTS) -m "not campaign"

# Before a release, or after a large change: long campaigns, beyond `make test`.
verify: .venv/.installed-test
	$(TESTS) -m campaign

lint: .venv/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --cache-dir .cache/import_linter --no-logo
	$(BIN)/mypy --num-workers 2

# How fast this machine is, in about two minutes.
bench: .venv/.installed
	$(BIN)/python experiments/run.py bench

# Every published or foreign answer that is known, beside ours: docs/conformance.md.
conformance: .venv/.installed-test
	$(BIN)/python experiments/run.py conformance
	$(BIN)/python experiments/run.py update_docs

# A measured robot beside its simulation: docs/validation.md.
validate: .venv/.installed-test
	$(BIN)/python experiments/run.py validate
	$(BIN)/python experiments/run.py identify_spine
	$(BIN)/python experiments/run.py spine_dynamics
	$(BIN)/python experiments/run.py update_docs

# What the library does, as the docs quote it; more than an hour on 2 cores, which should have nothing else to do.
# Nothing runs experiments/studies/ but you.
measure: .venv/.installed-test
	all=$$($(BIN)/python experiments/run.py --measured) && echo "$$all" | while read -r each; do \
		$(BIN)/python experiments/$$each </dev/null || exit 1; done

clean:
	rm -rf .venv .cache results build dist docs/reference *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/.installed: EXTRAS = view,video
.venv/.installed-test: EXTRAS = view,video,test
.venv/.installed-docs: EXTRAS = view,video,docs
.venv/.installed .venv/.installed-test .venv/.installed-docs: pyproject.toml constraints.txt
	@echo "installing jaxgrity and what it needs into .venv/: some minutes, once"
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[$(EXTRAS)]'
	touch .venv/.installed $@
