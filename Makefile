# make grasp: install into .venv, train a retargeter, simulate grasps, show the results.
# make test:  install the test extra and run the tests.
# make test-lowest: the same with the oldest versions of the dependencies, in .venv-lowest.
# make docs: build the documentation into site/, offline.
# make pictures: record a training, a grasp and the like, and make the docs' pictures of them.
PYTHON ?= python3
VENV ?= .venv
CONSTRAINTS ?= constraints.txt
BIN := $(VENV)/bin

.PHONY: grasp test test-lowest lint docs pictures clean

grasp: $(VENV)/installed
	$(BIN)/python scripts/simulate_grasp.py $(ARGS)

test: $(VENV)/installed-test
	$(BIN)/python -m pytest -n 2 $(ARGS)

test-lowest:
	$(MAKE) test VENV=.venv-lowest CONSTRAINTS=constraints-lowest.txt

pictures: $(VENV)/installed
	$(BIN)/python studies/pictures.py $(ARGS)

docs: $(VENV)/installed-docs
	$(BIN)/mkdocs build --strict

lint: $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: $(VENV)/bin/python pyproject.toml $(CONSTRAINTS)
	$(BIN)/python -m pip install --quiet --constraint $(CONSTRAINTS) --editable .
	touch $@

$(VENV)/installed-test: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --constraint $(CONSTRAINTS) --editable '.[test]'
	touch $@

$(VENV)/installed-docs: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --constraint $(CONSTRAINTS) --editable '.[docs]'
	touch $@

clean:
	rm -rf $(VENV) .venv-lowest runs site
