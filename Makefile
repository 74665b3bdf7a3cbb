# make grasp: install into .venv, simulate grasps, show the results; ARGS="--retargeter geort" trains a retargeter first.
# make test:  install the test extra and run the tests but the slow ones, which takes three to six minutes on
#             two cores; ARGS="-k planner" runs some of them.
# make test-all: run the slow ones, too, see CONTRIBUTING.md.
# make test-lowest, make test-newest: the same with the oldest and the newest versions of the dependencies,
#             in .venv-lowest and .venv-newest; PYTHON=python3.13 chooses the interpreter.
# make test-kernels: run the tests that train under each of torch's kernels that this processor has, with three
#             seeds and a margin of two.
# make wheel: build wheel and source distribution into dist/ and check them.
# make live: build the live web page, which needs Node.js 20; NPM_ARGS= also fetches what its tests need.
# make tables: write the tables of the docs that come from the code.
# make docs: build the documentation into site/, offline.
# make pictures: record a training, a grasp and the like, and make the docs' pictures of them.
PYTHON ?= python3
VENV ?= .venv
CONSTRAINTS ?= constraints.txt
NPM_ARGS ?= --omit=dev
# Modules are compiled where they are imported, not all at once, which would take a minute.
PIP_ARGS ?= --no-compile
BIN := $(VENV)/bin

.PHONY: grasp test test-lowest test-newest test-all test-kernels lint wheel live docs tables pictures clean

grasp: $(VENV)/installed
	$(BIN)/python scripts/simulate_grasp.py $(ARGS)

# Many small numerical jobs: more threads than cores would only wait. Without bytecode files, each of the many
# programs that tests start would compile the package again.
test: $(VENV)/installed-test
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal $(ARGS)

test-lowest:
	$(MAKE) test VENV=.venv-lowest CONSTRAINTS=constraints-lowest.txt

test-newest:
	$(MAKE) test VENV=.venv-newest CONSTRAINTS=/dev/null

test-kernels: $(VENV)/installed-test
	$(BIN)/python tests/kernels.py

test-all:
	$(MAKE) test ARGS="-m '' $(ARGS)"

live:
	@command -v npm >/dev/null || { echo "make live needs Node.js 20 or newer, with npm"; exit 1; }
	cd web && npm ci --ignore-scripts $(NPM_ARGS) && npm run build

pictures: $(VENV)/installed
	$(BIN)/python studies/pictures.py $(ARGS)

tables: $(VENV)/installed-docs
	$(BIN)/cog -r -I docs -p 'from tables import *' $$(grep -rl '\[\[\[cog' README.md docs --include=*.md)

docs: $(VENV)/installed-docs
	$(BIN)/mkdocs build --strict

lint: $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

wheel: $(VENV)/installed-test
	rm -rf dist
	$(BIN)/python -m build --outdir dist .
	$(BIN)/python -m twine check --strict dist/*

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: $(VENV)/bin/python pyproject.toml $(CONSTRAINTS)
	$(BIN)/python -m pip install --quiet $(PIP_ARGS) --constraint $(CONSTRAINTS) --editable .
	touch $@

# The test extra contains all that the package itself needs, so one installation serves both.
$(VENV)/installed-test: $(VENV)/bin/python pyproject.toml $(CONSTRAINTS)
	$(BIN)/python -m pip install --quiet $(PIP_ARGS) --constraint $(CONSTRAINTS) --editable '.[test]'
	touch $(VENV)/installed $@

$(VENV)/installed-docs: $(VENV)/installed
	$(BIN)/python -m pip install --quiet $(PIP_ARGS) --constraint $(CONSTRAINTS) --editable '.[docs]'
	touch $@

clean:
	rm -rf $(VENV) .venv-lowest .venv-newest dist runs site web/node_modules geort_drake/live/web/static
