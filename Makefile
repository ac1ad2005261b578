# make run: the main job, from a fresh clone.   make test: every check.   make lock: pin what is installed.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: run test lock

run: .venv/installed
	$(BIN)/python -m harness run --methods all --envs cartpole,highway

test: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/pytest -q -n auto --dist worksteal

# Local labels such as +cpu name a build, not a version that an index offers.
lock: $(BIN)/python
	$(BIN)/pip install --upgrade --upgrade-strategy eager -e '.[dev]'
	$(BIN)/pip freeze --exclude-editable | sed -E 's/\+[A-Za-z0-9.]+$$//' > constraints.txt

$(BIN)/python:
	$(PYTHON) -m venv .venv

.venv/installed: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/pip install --quiet -c constraints.txt -e .
	touch $@

.venv/installed-dev: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/pip install --quiet -c constraints.txt -e '.[dev]'
	touch $@ .venv/installed
