# make thesis: build the environment, run the thesis's experiments, write the report
# make test:   run the linter, the type checker and all tests
# make lesson: open the lesson, a notebook of 45 minutes, in a browser
# make docs:   build the documentation; open site/index.html

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
OUT ?= outputs

KILLS ?= 300
SEED ?= 0

.PHONY: help env thesis map map-full test lint lesson docs bench soak test-slurm test-ray test-pythons test-lowest clean

help:
	@sed -n 's/^# //p' Makefile

env: $(READY)

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed, but this is " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $(READY)

thesis: $(READY)
	$(BIN)/trl-explore thesis --out $(OUT)

# make map:     train a small map of the mixtures and write its page (minutes)
map: $(READY)
	$(BIN)/trl-explore map --jobs $(OUT)/map

# make map-full: the map of docs/map.html: 318 cells of 1,000 agents
map-full: $(READY)
	nice -n 10 $(BIN)/trl-explore map --full --jobs $(OUT)/map-full

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

test: lint
	$(BIN)/python -m pytest -n 2 --dist worksteal

lesson: $(READY)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[lesson]'
	cd lesson && ../$(BIN)/jupyter lab lesson.ipynb

docs: $(READY)
	$(BIN)/mkdocs build --quiet

# make bench:  measure the speed and write results.md, stepping.md and networks.md in benchmarks/
bench: $(READY)
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/stepping.py
	$(BIN)/python benchmarks/networks.py

# make soak:   kill a sweep at random times, KILLS times, and compare every file
soak: $(READY)
	$(BIN)/python tests/soak/kill.py --kills $(KILLS) --seed $(SEED)

# make test-slurm, test-ray: run a sweep on a Slurm and on a Ray cluster that are started for it
test-slurm: $(READY)
	$(BIN)/python tests/engines/slurm.py

test-ray:
	PYTHON=$(PYTHON) tests/engines/ray.sh

# make test-pythons, test-lowest: test under other Pythons, and with the lowest versions of packages
test-pythons:
	tests/engines/pythons.sh

test-lowest:
	PYTHON=$(PYTHON) tests/engines/lowest.sh

clean:
	rm -rf $(VENV) build *.egg-info .pytest_cache .ruff_cache
