# make install, make run: what running needs; make test adds the rest. All in .venv, from Python, a compiler and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
TESTING := $(VENV)/.installed-for-tests

# Real data and real weights, when they lie beside the repository (see CONTRIBUTING.md).
ifneq ($(wildcard ../shared/data),)
export BGS_TEST_DATA ?= $(abspath ../shared/data)
endif
ifneq ($(wildcard ../shared/weights),)
export BGS_WEIGHTS ?= $(abspath ../shared/weights)
endif

.PHONY: install run test quick check fuzz bench sanitize aarch64 gpu-check map-viewer browser-test docs wheels wheel-test clean

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt CMakeLists.txt $(wildcard bench/native/*)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable .
	-$(BIN)/bgs-bench weights get alexnet psmnet_kitti2015 xfeat
	touch $(STAMP)

# What the tests need beside.
$(TESTING): $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $(TESTING)

run: install
	$(BIN)/bgs-bench run output=results/runs/street rerun=true

test: check
	$(BIN)/python -m pytest -n 2 --dist worksteal

# Under two minutes: without real data and weights, and without the tests that are marked slow.
quick: check
	env -u BGS_TEST_DATA -u BGS_WEIGHTS $(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

check: $(TESTING)
	$(BIN)/ruff check bench plugins tests tools
	$(BIN)/ruff format --check bench plugins tests tools
	$(BIN)/clang-format --dry-run --Werror bench/native/*.cpp bench/native/*.h bench/native/*.inc
	$(BIN)/mypy

# The pages in build/docs; ends at the first warning, such as a link that leads nowhere.
docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet

# Source archive, and the wheel that it builds, into dist/.
wheels: $(STAMP)
	rm -rf dist
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt build
	$(BIN)/python -m build

# The wheel in an empty environment outside the checkout. WHOLE=--whole installs the dependencies there too.
wheel-test: wheels
	$(BIN)/python -m tools.wheel_check $(WHOLE) dist/*.whl

# A thousand spoilt files of all kinds; `make test` tries a hundred.
fuzz: $(TESTING)
	BGS_FUZZ=1000 $(BIN)/python -m pytest tests/fuzzing

bench: $(TESTING)
	OMP_WAIT_POLICY=passive $(BIN)/python -m pytest tests/performance -s

# On a machine with an NVIDIA GPU, by .venv or else by PYTHON as it is: nothing is installed (see docs/performance.md).
gpu-check:
	$(or $(wildcard $(BIN)/python),$(PYTHON)) -m tools.gpu_check

# The core built with the address and undefined-behaviour sanitizers, in a folder of its own, and its tests for each
# instruction set; the first finding ends them. Python itself and torch leak at their end, so leaks are not looked for.
SANITIZED := build/sanitize
CORE_TESTS := tests/native tests/rasterizers tests/losses tests/gaussians/test_optimizer.py tests/tracking

sanitize: $(TESTING)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --upgrade --target $(SANITIZED) \
		--config-settings=build-dir=$(SANITIZED)/cmake --config-settings=cmake.define.BGS_SANITIZE=ON .
	for kernels in baseline avx2 avx512; do \
		LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libstdc++.so)" BGS_KERNELS=$$kernels \
		BGS_CORE=$$(ls $(SANITIZED)/bench/_native*.so) ASAN_OPTIONS=detect_leaks=0 \
		UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1 \
		$(BIN)/python -m pytest -p tools.sanitized_core $(CORE_TESTS) || exit 1; \
	done

# The core's kernels for aarch64 under qemu-user against those for x86-64; needs Debian's g++-aarch64-linux-gnu and qemu-user.
aarch64: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt cmake
	$(BIN)/python -m tools.core_on_aarch64

# What writes the report's maps in 3D; needs node 18 or newer and npm. bench/report/pages/map_page.py names the version too.
map-viewer:
	npm install --prefix build/map_viewer --no-save --ignore-scripts --no-audit --no-fund @playcanvas/splat-transform@2.7.1

# The report's pages and the map's view in Chromium (/usr/bin/chromium, or $$BGS_CHROMIUM).
browser-test: $(TESTING)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[browser,viewer]'
	$(BIN)/python -m pytest -m browser tests/report tests/viewers

clean:
	rm -rf $(VENV) build dist
