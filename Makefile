# make install, make run, make test: everything happens in .venv; nothing is needed before but Python, a compiler, make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

# Real data and real weights, when they lie beside the repository (see README, "Tests with real data").
ifneq ($(wildcard ../shared/data),)
export BGS_TEST_DATA ?= $(abspath ../shared/data)
endif
ifneq ($(wildcard ../shared/weights),)
export BGS_WEIGHTS ?= $(abspath ../shared/weights)
endif

.PHONY: install run test quick check bench clean

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt CMakeLists.txt $(wildcard bench/native/*)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	-$(BIN)/bgs-bench weights get alexnet psmnet_kitti2015
	touch $(STAMP)

run: install
	$(BIN)/bgs-bench run output=results/runs/street rerun=true

test: check
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

# Under two minutes: without real data and weights, and without the tests that are marked slow.
quick: check
	env -u BGS_TEST_DATA -u BGS_WEIGHTS $(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

check: install
	$(BIN)/ruff check bench plugins tests tools
	$(BIN)/ruff format --check bench plugins tests tools
	$(BIN)/mypy

bench: install
	OMP_WAIT_POLICY=passive $(BIN)/python -m pytest tests/performance -s

clean:
	rm -rf $(VENV) build
