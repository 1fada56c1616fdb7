# Every target makes the virtual environment it needs; only Python 3.9+ and make have to be there.
#   make demo        fit three organs in a synthetic pelvic MRI, pictures in build/demo
#   make test        run the tests
#   make lint        check style and format
#   make benchmark   measure accuracy, robustness, time and memory
#   make screenshots draw the README's pictures of Slicer (needs Python 3.10+ and OpenGL, no Slicer)
#   make reproduce   repeat the paper's validation, table and plots in build/reproduce
#   make clean       remove everything made by the above

PYTHON ?= python3
RUFF := ruff==0.17.6

VENV := .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/python -m pip install -q --disable-pip-version-check

.PHONY: demo test lint benchmark reproduce screenshots clean

demo: $(VENV)/demo.stamp
	$(BIN)/python -m VICRegistrationLib.demo build/demo

test: $(VENV)/test.stamp
	$(BIN)/python -m pytest -q -n auto --dist loadfile

lint: $(VENV)/lint.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

benchmark: $(VENV)/demo.stamp
	$(BIN)/python Testing/benchmarks/run.py

reproduce: $(VENV)/pictures.stamp
	$(BIN)/vic-registration reproduce build/reproduce

screenshots: $(VENV)/screenshots.stamp
	$(BIN)/python Resources/draw_screenshots.py
	$(BIN)/python Resources/draw_panel.py

clean:
	rm -rf $(VENV) build .pytest_cache .ruff_cache VICRegistration/*.egg-info

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# The interpreter is an order-only prerequisite: it is a link whose date is that of the system's Python.
$(VENV)/pictures.stamp: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable '.[pictures]'
	touch $@

$(VENV)/demo.stamp: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable '.[pictures,mesh]'
	touch $@

$(VENV)/test.stamp: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable '.[test]'
	touch $@

$(VENV)/screenshots.stamp: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable '.[screenshots]'
	touch $@

$(VENV)/lint.stamp: Makefile | $(BIN)/python
	$(INSTALL) '$(RUFF)'
	touch $@
