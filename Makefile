# Every target makes the virtual environment it needs; only Python 3.9+ and make have to be there.
#   make demo        fit three organs in a synthetic pelvic MRI, pictures in build/demo
#   make test        run the tests
#   make test-oldest run them with the oldest Python and packages that are promised
#   make lint        check style and format
#   make benchmark   measure accuracy, robustness, time and memory
#   make figures     measure all that the pages cite, keep it in docs/measured, renew the tables of the pages (hours)
#   make screenshots draw the README's pictures of Slicer (needs Python 3.10+ and OpenGL, no Slicer)
#   make reproduce   repeat the paper's validation, table and plots in build/reproduce
#   make clean       remove everything made by the above

PYTHON ?= python3
OLDEST_PYTHON ?= python3.9
RUFF := ruff==0.17.6

VENV := .venv
BIN := $(VENV)/bin
OLDEST := .venv-oldest
INSTALL := $(BIN)/python -m pip install -q --disable-pip-version-check

.PHONY: demo test test-oldest lint benchmark figures reproduce screenshots clean

demo: $(VENV)/demo.stamp
	$(BIN)/python -m VICRegistrationLib.demo build/demo

test: $(VENV)/test.stamp
	$(BIN)/python -m pytest -q -n auto --dist loadfile

test-oldest: $(OLDEST)/test.stamp
	$(OLDEST)/bin/python -m pytest -q -n auto --dist loadfile

lint: $(VENV)/lint.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

benchmark: $(VENV)/demo.stamp
	$(BIN)/python Testing/benchmarks/run.py

figures: $(VENV)/test.stamp
	$(BIN)/python Testing/benchmarks/run.py --all --write

reproduce: $(VENV)/pictures.stamp
	$(BIN)/vic-registration reproduce build/reproduce

screenshots: $(VENV)/screenshots.stamp
	$(BIN)/python Resources/draw_screenshots.py
	$(BIN)/python Resources/draw_panel.py

clean:
	rm -rf $(VENV) $(OLDEST) build .pytest_cache .ruff_cache VICRegistration/*.egg-info

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# The interpreter is an order-only prerequisite: it is a link whose date is that of the system's Python.
$(VENV)/pictures.stamp: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable '.[pictures]'
	touch $@

$(VENV)/demo.stamp: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable '.[pictures,mesh,dicom]'
	touch $@

$(VENV)/test.stamp: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable '.[test]'
	touch $@

$(OLDEST)/test.stamp: pyproject.toml Testing/oldest.txt
	$(OLDEST_PYTHON) -m venv $(OLDEST)
	$(OLDEST)/bin/python -m pip install -q --disable-pip-version-check --editable '.[test]' -c Testing/oldest.txt
	touch $@

$(VENV)/screenshots.stamp: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable '.[screenshots]'
	touch $@

$(VENV)/lint.stamp: Makefile | $(BIN)/python
	$(INSTALL) '$(RUFF)'
	touch $@
