# `make demo` and `make test` set everything up in .venv (Debian 12: python3.11, make and g++ are enough).
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
PY := $(BIN)/python

.PHONY: setup demo test test-all test-service lint page page-check docs clean
setup: $(VENV)/.installed

$(PY):
	$(PYTHON) -m venv $(VENV)

# Pinned by constraints.txt. The build runs without isolation, so that it uses the pinned tools; they are in $(BIN),
# which must come first on the path.
$(VENV)/.installed: pyproject.toml constraints.txt CMakeLists.txt $(shell find mgsr/native -name '*.h' -o -name '*.cpp') | $(PY)
	$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt scikit-build-core nanobind cmake ninja
	PATH="$(CURDIR)/$(BIN):$$PATH" $(PY) -m pip install -q --disable-pip-version-check -c constraints.txt \
		--no-build-isolation -e '.[dev]'
	touch $@

demo: setup
	$(BIN)/mgsr demo

lint: setup
	$(BIN)/ruff check .
	$(BIN)/mypy

# A file's tests stay in one process: they share what they make. Files run in the order of their names, as the files
# with the fewest tests, which pytest-xdist would run last, take the longest.
test: lint
	$(PY) -m pytest -n auto --dist loadfile --no-loadscope-reorder -m "not slow"

test-all: lint
	$(PY) -m pytest

# The service's tests alone, with the slow ones: load, chaos, S3.
test-service: setup
	$(PY) -m pytest tests/service tests/worker

# The web page's bundle, service/page/built, which is committed: only changing the page needs Node 20 and npm.
page: service/page/node_modules/.installed
	cd service/page && npm run --silent build

# The page's types, and whether the committed bundle is what its sources give.
page-check: service/page/node_modules/.installed
	cd service/page && npm run --silent check

service/page/node_modules/.installed: service/page/package.json service/page/package-lock.json
	cd service/page && npm ci --ignore-scripts --no-audit --no-fund
	touch $@

# The documentation as a site, in build/site; broken links and pages that no menu names are errors.
docs: setup
	$(BIN)/mkdocs build --strict

clean:
	rm -rf $(VENV) build out mgsr/native/*.so
