# Two commands: `make validate` runs the main job, `make test` checks the project. Both set up .venv first.
PYTHON ?= python3
GAITS ?= normal momentum
ARGS ?=
JOBS ?= 2

VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
INSTALLED_TEST := $(VENV)/.installed-test
SETTINGS := pyproject.toml constraints.txt
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

# Headless: MuJoCo must not look for a display. One thread per process: the matrices are small, and a run's
# bits must not depend on how many cores share the work.
export MUJOCO_GL ?= disable
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help validate test test-all check lint types docs bench install clean

help:  ## List the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## */  make \1\t/' | expand -t 18

validate: $(INSTALLED)  ## Plan, walk and judge normal and momentum (GAITS=... ARGS=... to change it)
	@$(BIN)/ampm validate $(GAITS) $(ARGS)

test: check  ## Lint, types, documentation, and every test that is not marked slow
	@$(BIN)/pytest -n $(JOBS) --dist loadfile $(ARGS)

test-all: check  ## The same with every test, those marked slow included
	@$(BIN)/pytest -n $(JOBS) --dist loadfile -m '' $(ARGS)

check: $(INSTALLED_TEST)
	@$(MAKE) --no-print-directory --output-sync -j $(JOBS) lint types docs

lint: $(INSTALLED_TEST)  ## ruff: rules and formatting
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .

types: $(INSTALLED_TEST)  ## mypy
	@$(BIN)/mypy

bench: $(INSTALLED_TEST)  ## Time the planner, the controller and the simulation
	@$(PIP_INSTALL) -e '.[bench]'
	@$(BIN)/python -m benchmarks $(ARGS)

docs: $(INSTALLED_TEST)  ## Build the pages in build/site (its search needs a server: python -m http.server -d build/site)
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

install: $(INSTALLED)  ## Only create .venv and install

clean:  ## Remove .venv and caches (never runs/)
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache build

$(BIN)/python:
	@command -v $(PYTHON) >/dev/null 2>&1 || { \
	  echo "make: there is no '$(PYTHON)' here; install Python 3.11 or newer, or name it: make PYTHON=/path/to/python3." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "make: '$(PYTHON)' is older than Python 3.11; name a newer one: make PYTHON=/path/to/python3." >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
	  echo "make: Python cannot create a virtual environment here; on Debian, run 'sudo apt-get install python3-venv' and try again." >&2; exit 1; }
	@echo "Creating $(VENV) ..."
	@rm -rf $(VENV)
	@$(PYTHON) -m venv $(VENV)

$(INSTALLED): $(SETTINGS) | $(BIN)/python
	@echo "Installing into $(VENV) (about 2 GB, a minute or two) ..."
	@$(PIP_INSTALL) -e .
	@$(BIN)/python -c 'import sys; sys.exit(sys.version_info < (3, 13))' || exit 0; \
	  $(PIP_INSTALL) --no-deps dm-control  # see the reason in pyproject.toml
	@touch $@

$(INSTALLED_TEST): $(SETTINGS) | $(INSTALLED)
	@$(PIP_INSTALL) -e '.[test]'
	@touch $@
