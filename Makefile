# `make demo`, `make train` and `make test` do all the set-up on a fresh machine.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# What training and the shipped agent need, and what tests, checks and documentation need beside.
STAMP := $(VENV)/.installed
TESTED := $(VENV)/.tested
INSTALL := $(BIN)/python -m pip install --quiet --constraint constraints.txt --editable
# All tests of a file in one process, which makes the file's fixtures once.
PYTEST := $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

# Overrides for `make train`, such as ARGS="cams=rgb_default seed=1".
ARGS ?=

.PHONY: setup demo train test test-all screens check docs findings format clean

setup: $(STAMP)

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "needlehoop needs Python 3.11 or newer")'
	$(PYTHON) -m venv $(VENV)

# pip, not uv: it honours PIP_FIND_LINKS and the index settings of shared machines.
$(STAMP): pyproject.toml constraints.txt | $(BIN)/python
	$(INSTALL) .
	touch $@

# In one call, not after $(STAMP): each call of pip looks at every package again.
$(TESTED): pyproject.toml constraints.txt | $(BIN)/python
	$(INSTALL) '.[dev]'
	touch $(STAMP) $@

demo: $(STAMP)
	$(BIN)/needlehoop watch $(ARGS)

# Two cameras, unless ARGS say what is seen or which run goes on.
CAMS := $(if $(strip $(foreach key,cams= obs= resume=,$(findstring $(key),$(ARGS)))),,'cams=[dep_front,seg_side]')

train: $(STAMP)
	$(BIN)/python train.py $(CAMS) $(ARGS)

test: $(TESTED)
	$(PYTEST)

# Everything that `make test` leaves out, or tries a slice of, as well.
test-all: $(TESTED) screens
	NEEDLEHOOP_TEST=all $(PYTEST)

# Debian's Chromium, which opens the report in a test. Where it is missing, that test is skipped.
screens:
	@command -v chromedriver >/dev/null || { test "$$(id -u)" = 0 \
	  && command -v apt-get >/dev/null && apt-get update -qq && apt-get install -y -qq \
	  --no-install-recommends chromium chromium-driver; } \
	  || echo "no chromedriver: no test opens the report in a browser"

check: $(TESTED)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright --pythonpath $(BIN)/python

docs: $(TESTED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# What results/ says: its tables, those of docs/findings.md and evidence.md, the figures of README.md
# and evidence.md, and results/report.html, which git ignores.
findings: $(TESTED)
	for study in fast table2 rewards; do $(BIN)/needlehoop plot results/$$study || exit; done
	cp results/rewards/figures/rewards.png docs/
	$(BIN)/python -m analysis.findings
	$(BIN)/python -m analysis.report

format: $(TESTED)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) build site *.egg-info
