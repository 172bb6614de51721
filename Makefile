# `make demo` and `make test` set everything up in .venv (Debian 12: python3.11, make and g++ are enough).
PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python

.PHONY: setup demo test test-all lint native clean
setup: $(VENV)/.installed

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

# Pinned by constraints.txt; the native build runs here, without isolation so that it uses the pinned tools.
$(VENV)/.installed: pyproject.toml constraints.txt CMakeLists.txt $(shell find mgsr/native -name '*.h' -o -name '*.cpp') | $(VENV)/bin/python
	$(PY) -m pip install -q -c constraints.txt scikit-build-core nanobind cmake ninja
	$(PY) -m pip install -q -c constraints.txt --no-build-isolation -e '.[dev]'
	touch $@

demo: setup
	$(VENV)/bin/mgsr-worker run examples/glossy_knot -o out/demo --preset draft

lint: setup
	$(VENV)/bin/ruff check . && $(VENV)/bin/mypy

test: setup lint
	$(PY) -m pytest -m "not slow"

test-all: setup lint
	$(PY) -m pytest

clean:
	rm -rf $(VENV) build out mgsr/native/*.so
