# make demo   sets up what it needs and lets six robots work a real field, on a map in your browser
#             (OPTIONS="--page-port 0" where the port of the page is taken)
# make fast   the unit tests of what a core computes: no fleets, no processes; a minute on two cores
# make test   sets everything up, checks style and types, runs the tests but for the slow ones
# make slow   the slow tests: real launches, long runs, documented commands as they stand, all examples of properties
# make check  format, style and types only      make bench  every figure our documents claim, quickly
# make coverage  lines and branches that the tests of replicated state, frames and safety run, with floors
# make lock   requirements.lock: all packages with their hashes, for `pip install --require-hashes`
# make site   the documents as a site in build/site
# make lowest  the tools and the fast tests with the oldest packages that pyproject.toml allows
# make release VERSION=0.5.0  changelog, version, wheel, commit and tag; nothing is pushed
# make clean  removes what the others made
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Bytecode is kept: the tests start hundreds of processes, and a quarter of a robot's start was compiling it.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo fast test slow check coverage kernels bench site setup lock lowest release clean
.DEFAULT_GOAL := demo

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "headland: Python 3.11 or newer is needed; try: make PYTHON=python3.11"; exit 1; }
	@echo "making $(VENV): about 5 s ..."
	@$(PYTHON) -m venv $(VENV) 2>/dev/null || { rm -rf $(VENV); \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    echo "Python has no venv; apt-get installs it: about 30 s ..."; \
	    apt-get update -qq && apt-get install -y -qq python3-venv >/dev/null; \
	  else echo "headland: Python has no venv; install it with: apt-get install python3-venv"; exit 1; fi; \
	  $(PYTHON) -m venv $(VENV); }

# uv downloads files beside each other, pip one after the other: 25 s become 2 minutes. pip does it where uv is not to
# be had, or does not reach an index that only pip is configured for. uv gives up after 10 s without an answer.
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
define install
@echo "installing $(2) into $(VENV): $(3) ..."
@{ command -v uv || [ -x $(BIN)/uv ] || $(PIP) install uv; } >/dev/null 2>&1; \
  PATH="$(BIN):$$PATH" UV_HTTP_TIMEOUT=10 uv pip install --quiet --python $(BIN)/python -e '.[$(1)]' 2>/dev/null || { \
  echo "uv could not install it; pip does: about two minutes ..."; \
  $(PIP) install --config-settings editable_mode=compat -e '.[$(1)]'; }
endef

# What `headland run --map` needs, and no more.
DEMO := sim,operator
$(VENV)/playable: pyproject.toml | $(BIN)/python
	$(call install,$(DEMO),what the demo needs,about 30 s and 660 MB)
	@touch $@

setup: $(VENV)/installed
$(VENV)/installed: pyproject.toml | $(BIN)/python
	$(call install,dev,all that the tests need,about a minute and 1.3 GB)
	@touch $(VENV)/playable
# ROS 2 requires lark-parser, an old name of lark: both write the package lark, and the older one adds types of its own.
	@! $(PIP) show lark-parser 2>/dev/null || { \
	  $(PIP) uninstall --yes lark-parser && $(PIP) install --no-deps --force-reinstall 'lark>=1.1'; }
	@$(PIP) install --no-deps pyrvo || \
	  echo "pyrvo is not to be had here: the comparison with RVO2 will be skipped"
	@touch $@

# uv resolves for all platforms at once; it is not needed for anything else.
lock:
	@$(PYTHON) -m venv build/lock && build/lock/bin/python -m pip install --quiet uv
	@build/lock/bin/uv pip compile --quiet pyproject.toml --all-extras --generate-hashes --universal \
	  --python-version 3.11 --no-header --no-emit-index-url -o requirements.lock
	@sed -i "1i # Made by 'make lock': every package that '.[dev]' installs, with the hashes of its files." requirements.lock

demo: $(VENV)/playable
	$(BIN)/headland run --map $(OPTIONS)

check: setup
	$(BIN)/ruff format --check --quiet .
	$(BIN)/ruff check .
	$(BIN)/mypy

# Once and beside the types: tests that begin together would each compile what they both need.
kernels: setup
	@$(BIN)/headland compile --kernels

test: setup
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target check kernels
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

fast: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow and not fleet and not process"

# Floors are percents, a little below what was reached: raise them with the tests.
COVERED := tests/crdt tests/protocol tests/agent/interface tests/agent/peer tests/agent/safety
coverage: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow" --hypothesis-profile thorough --cov --cov-report= $(COVERED)
	$(BIN)/coverage report --include='crdt/*' --fail-under=93
	$(BIN)/coverage report --include='protocol/*' --fail-under=80
	$(BIN)/coverage report --include='agent/safety/*' --fail-under=88

slow: setup kernels
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "slow or hypothesis" --hypothesis-profile thorough

bench: setup
	$(BIN)/headland bench all --quick

site: setup
	$(BIN)/python -m tools.cli.doc_pages docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "the site is in build/site/index.html"

LOWEST := build/lowest
lowest:
	@$(PYTHON) -m venv $(LOWEST) && $(LOWEST)/bin/python -m pip install --quiet uv
	@$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct -e '.[sim,operator]'
	@$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python pytest pytest-asyncio pytest-xdist hypothesis
	$(LOWEST)/bin/python -m pytest -n 2 -m "not slow and not fleet and not process" tests/crdt tests/protocol tests/agent tests/tools/cli

release: setup
	$(BIN)/python -m tools.build.release $(VERSION)

clean:
	rm -rf $(VENV) runs build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
