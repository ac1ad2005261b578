# make run: the main job, from a fresh clone.   make test: every check.   make docs: the pages, as HTML.
# make lock: pin what is installed.
PYTHON ?= python3
BIN := .venv/bin
INSTALL := $(BIN)/uv pip install --quiet --python $(BIN)/python
# uv reads none of pip's settings: what it may need of them.
export UV_FIND_LINKS ?= $(PIP_FIND_LINKS)
ifdef PIP_INDEX_URL
export UV_DEFAULT_INDEX ?= $(PIP_INDEX_URL)
endif

# Tests wait for processes half of the time.
WORKERS := $(shell expr $$(getconf _NPROCESSORS_ONLN) \* 3 / 2)

# Where a shell forbids bytecode, each of hundreds of processes would compile this program again.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: run test docs lock

run: .venv/installed
	$(BIN)/python -m harness run --methods all --envs cartpole,highway

test: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	{ $(BIN)/mypy && $(BIN)/python -m sphinx -q -W --keep-going docs build/docs; } & beside=$$!; \
	$(BIN)/pytest -q -n $(WORKERS) --dist worksteal; tested=$$?; \
	wait $$beside && exit $$tested

docs: .venv/installed-dev
	$(BIN)/python -m sphinx -q -W --keep-going docs build/docs
	@echo build/docs/index.html

# Local labels such as +cpu name a build, not a version that an index offers.
lock: $(BIN)/uv
	$(INSTALL) --upgrade uv -e '.[dev]'
	$(BIN)/pip freeze --exclude-editable | sed -E 's/\+[A-Za-z0-9.]+$$//' > constraints.txt

$(BIN)/uv:
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet -c constraints.txt uv

.venv/installed: pyproject.toml constraints.txt | $(BIN)/uv
	$(INSTALL) -c constraints.txt -e .
	touch $@

.venv/installed-dev: pyproject.toml constraints.txt | $(BIN)/uv
	$(INSTALL) -c constraints.txt -e '.[dev]'
	touch $@ .venv/installed
