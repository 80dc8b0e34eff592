# Everything is installed into .venv by the first target that needs it. `make` lists the targets.

PYTHON ?= python3
WORKERS ?= 2
VENV := .venv
BIN := $(VENV)/bin
DEMO := out/demo
PYTEST := $(BIN)/pytest --numprocesses $(WORKERS) --dist loadfile --no-loadscope-reorder
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input

# Every command would compile bough's own files again where the shell forbids Python to keep what it compiled.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-all lint format bench tables pages docs clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-8s %s\n", $$1, $$2}' $(firstword $(MAKEFILE_LIST))

setup: $(VENV)/installed-test  ## install bough and what its tests need into .venv

$(BIN)/python:
	@command -v $(PYTHON) >/dev/null || { echo "bough needs Python 3.10 or later; there is no $(PYTHON)." \
		"Name one: make PYTHON=/path/to/python3"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || { echo "bough needs Python 3.10 or later;" \
		"$(PYTHON) is $$($(PYTHON) -V 2>&1). Name another: make PYTHON=/path/to/python3"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@$(PIP) install --quiet "pip>=24.1"  # the one that Python 3.10 brings searches for versions for hours

# .venv/name/bough is this folder under the package's name, for the tools that read source without importing it.
$(VENV)/installed-%: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --editable ".[$*]" --constraint constraints.txt
	@mkdir -p $(VENV)/name && ln -sfn ../.. $(VENV)/name/bough
	@touch $@

demo: $(VENV)/installed-test  ## grow a forest, simulate it, learn a branch's springs, find what it lacks (minutes)
	$(BIN)/bough forest --species Ta --count 64 --order 2 --noise 0.1 --seed 0 --out $(DEMO)/forest
	$(BIN)/bough simulate $(DEMO)/forest/tree_0000.xml --bend 0.2 --worlds 64 --seconds 2 --precision 32 \
		--out $(DEMO)/motion
	$(BIN)/bough hide --seed 1 --segments 3 --noise 0.03 --out $(DEMO)/case
	$(BIN)/bough identify $(DEMO)/case --out $(DEMO)/identified
	$(BIN)/bough hide --effects quadratic_drag --seed 7 --out $(DEMO)/hidden
	$(BIN)/bough diagnose $(DEMO)/hidden --out $(DEMO)/diagnosis
	@echo
	@echo "Look at $(DEMO)/forest/forest.png (the forest), open $(DEMO)/identified/report.html (what was learnt)" \
		"and $(DEMO)/diagnosis/report.html (what was missing; the answer is" \
		"$(DEMO)/hidden_answer.json)."

test: $(VENV)/installed-test  ## run the tests that guard behaviour (minutes; tests/long.py lists what is left out)
	$(PYTEST) -m "not long"

test-all: $(VENV)/installed-test  ## run all tests, the long oracles too
	$(PYTEST)

lint: $(VENV)/installed-dev  ## check style, formatting and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/installed-dev  ## mend what ruff can mend
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/installed-test $(VENV)/installed-sysid  ## measure all, or NAMES="tree contact" (wants an idle machine)
	$(BIN)/python benchmarks/run.py $(NAMES) $(if $(QUICK),--quick)

tables: $(VENV)/installed-test  ## write the tables of README and docs from the newest results of the benchmarks
	$(BIN)/python benchmarks/run.py --write

pages: $(VENV)/installed-test  ## run tutorials and gallery again and keep their pictures (minutes), or NAMES="write_law.ipynb"
	$(BIN)/python docs/remake.py $(NAMES)

docs: $(VENV)/installed-docs  ## build the documentation site in out/site
	$(BIN)/mkdocs build --strict

clean:  ## remove .venv, out and caches
	rm -rf $(VENV) out build dist *.egg-info .cache .pytest_cache .mypy_cache .ruff_cache .hypothesis
