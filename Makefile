# make grasp: install into .venv, train a retargeter, simulate grasps, show the results.
# make test:  install the test extra and run the tests.
# make pictures: record a training, a grasp and the like, and make the docs' pictures of them.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

.PHONY: grasp test lint pictures clean

grasp: $(VENV)/installed
	$(BIN)/python scripts/simulate_grasp.py $(ARGS)

test: $(VENV)/installed-test
	$(BIN)/python -m pytest -n 2 $(ARGS)

pictures: $(VENV)/installed
	$(BIN)/python scripts/make_pictures.py $(ARGS)

lint: $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: $(VENV)/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	touch $@

$(VENV)/installed-test: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[test]'
	touch $@

clean:
	rm -rf $(VENV) runs
