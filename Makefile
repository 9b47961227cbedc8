# One command per job. Everything is installed into .venv in this folder and nowhere else.
#
#   make serve            the service and its page on http://127.0.0.1:8000 (no torch)
#   make setup            everything: service, training, clients, checkers
#   make test             checks and the test suite but for its long tests
#   make quick            lint, imports and the tests that changed files reach, the nearest first, in a minute (BASE=COMMIT)
#   make test-quick       the tests without the slow ones
#   make test-all         every test
#   make test-avx2        every test once more as processors without AVX-512 round
#   make sanitize         the engine's tests with checks of memory and of what C++ leaves undefined (needs gcc)
#   make check            format, lint, types, import order, known vulnerabilities
#   make audit            known vulnerabilities of what is installed; fails where the package index cannot say
#   make format           write the format and the safe lint fixes
#   make bench            every benchmark, its quick form
#   make soak             fuzzed frames through the whole engine for ten minutes, ARGS="--frames 1000000 --seconds 1e9" for more; then drawn requests and streams
#   make image            the image drape:VERSION by podman or docker, tried (BASE, PLATFORMS: scripts/build_image)
#   make release          dist/: wheels for four systems, sdists, the packages for browsers and Blender, the image, a bill of
#                         materials, checksums; what runs on this system is tried
#   make clean            remove what was installed or built
#
# Options: PORT, HOST; PAGE=0 starts without the page (no Node.js needed);
# TORCH_INDEX=URL takes torch from that index (default: the CPU build unless the machine has an NVIDIA GPU);
# PYTHON names the interpreter the environment is made with; ARGS is handed to pytest, the benchmarks or the service (HOST=0.0.0.0 needs keys or ARGS=--open).

HOST ?= 127.0.0.1
PORT ?= 8000
PAGE ?= 1
PYTHON ?=
TORCH_INDEX ?=
ARGS ?=
BASE ?=

# uv writes no byte code: the first import has to, or every process compiles the packages anew.
export PYTHONDONTWRITEBYTECODE :=

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

VENV := .venv
BIN := $(VENV)/bin
INSTALL := scripts/install $(BIN)/python
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n 2 --dist loadfile --no-loadscope-reorder --durations=15
WEB := clients/web
MEMBERS := service clients recovery training model_export
PRODUCT := drape $(MEMBERS) benchmarks examples
ENGINE_SOURCES := drape/engine/build.py drape/engine/records.py $(wildcard drape/engine/source/*)
WEB_SOURCES := $(shell find $(WEB) \( -name node_modules -o -name dist \) -prune -o -type f -print 2>/dev/null)

.PHONY: help serve setup browser test test-all test-avx2 quick test-quick sanitize check audit format bench soak page image release clean

help:
	@sed -n '2,/^$$/{s/^# \{0,1\}//;p;}' Makefile

# --- environments. A stamp is newer than what it was made from; a second run installs nothing. ---

$(BIN)/python:
	@PYTHON="$(PYTHON)" scripts/timed "virtual environment" scripts/make_venv $(VENV)

$(VENV)/.serve-stamp: pyproject.toml service/pyproject.toml clients/pyproject.toml | $(BIN)/python
	@DRAPE_ENGINE=apart scripts/timed "packages from PyPI" $(INSTALL) -e . -e service -e clients
	@touch $@

# The engine needs nothing but Python, so it is compiled beside the packages.
$(VENV)/.engine-stamp: $(ENGINE_SOURCES) | $(BIN)/python
	@scripts/timed "engine" $(BIN)/python drape/engine/build.py
	@touch $@

$(VENV)/.engine-tests-stamp: $(ENGINE_SOURCES) | $(BIN)/python
	@scripts/timed "engine" $(BIN)/python drape/engine/build.py --tests
	@touch $(VENV)/.engine-stamp $@

# torch first and alone: later requirements then find it and cannot pull another build of it.
$(VENV)/.setup-stamp: pyproject.toml $(MEMBERS:=/pyproject.toml) | $(BIN)/python
	@scripts/timed "torch" scripts/install_torch $(BIN)/python 2.13.0 $(TORCH_INDEX)
	@DRAPE_ENGINE=apart scripts/timed "packages from PyPI" $(INSTALL) -e '.[cpu,dev]' -e 'service[otel]' $(addprefix -e ,$(filter-out service,$(MEMBERS)))
	@touch $(VENV)/.serve-stamp $@

setup:
	@$(MAKE) --no-print-directory -j2 $(VENV)/.setup-stamp $(VENV)/.engine-tests-stamp

# --- the page ---

# The engine comes first, and with it the compiler.
$(WEB)/dist/.stamp: $(WEB_SOURCES) $(ENGINE_SOURCES) | $(VENV)/.engine-stamp
	@scripts/timed "page" scripts/build_page $(WEB)

page: $(WEB)/dist/.stamp

# --- jobs ---

# The page is built beside the packages, which keep one core busy.
serve:
	@$(MAKE) --no-print-directory -j3 $(VENV)/.serve-stamp $(VENV)/.engine-stamp $(if $(filter 0,$(PAGE)),,page)
	exec $(BIN)/python -m service --host $(HOST) --port $(PORT) $(ARGS)

# The page and the browser are wanted by tests, not required: without them the browser tests skip and say why.
browser:
	@scripts/build_page $(WEB) --optional
	@scripts/find_chromium

# They are fetched while the engine is compiled. Checks run beside the tests, in the time in which these wait, and are
# printed after them. Types of the tests themselves are left to make check: they take as long as the product's.
test:
	@$(MAKE) --no-print-directory -j2 setup browser
	@tests=0; checked=0; nice -n 19 $(MAKE) --no-print-directory check TYPED="$(PRODUCT)" > $(VENV)/check.log 2>&1 & checks=$$!; \
	$(PYTEST) -m "not long" $(ARGS) \
	|| tests=$$?; wait $$checks || checked=$$?; cat $(VENV)/check.log; [ $$tests = 0 ] && [ $$checked = 0 ]

test-all: setup
	$(PYTEST) $(ARGS)

# What rounding alone decides comes out otherwise: libraries and the engine compute with AVX2.
test-avx2: setup
	DRAPE_ISA=v3 $(BIN)/python drape/engine/build.py --tests
	OPENBLAS_CORETYPE=Haswell DRAPE_ISA=v3 ATEN_CPU_CAPABILITY=avx2 MKL_ENABLE_INSTRUCTIONS=AVX2 ONEDNN_MAX_CPU_ISA=AVX2 \
	NPY_DISABLE_CPU_FEATURES="AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL" $(PYTEST) $(ARGS)

# The minute is that of the tests: what it leaves out is counted as skipped.
quick: setup
	@$(BIN)/ruff format --check -q . && $(BIN)/ruff check -q .
	@linted=0; tests=0; $(BIN)/lint-imports > $(VENV)/quick.log 2>&1 & lint=$$!; \
	files="$$($(BIN)/python scripts/quick.py $(BASE))"; \
	if [ -n "$$files" ]; then $(PYTEST) -m "unit and not slow and not long" --stop-after 30 $$files $(ARGS) || tests=$$?; fi; \
	wait $$lint || linted=$$?; [ $$linted = 0 ] || cat $(VENV)/quick.log; [ $$tests = 0 ] && [ $$linted = 0 ]

test-quick: setup
	$(PYTEST) -m "not slow and not long" $(ARGS)

# The runtime of the checks is gcc's, with which usd-core ends the process. The plain libraries come back at the end.
sanitize: setup
	$(BIN)/python -m drape.engine.build --tests --sanitize
	@failed=0; LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libstdc++.so)" ASAN_OPTIONS=detect_leaks=0 OMP_NUM_THREADS=1 \
	$(BIN)/python -m pytest -q -m "not long" tests/drape --ignore=tests/drape/garment/files/test_usd.py $(ARGS) || failed=$$?; \
	$(BIN)/python -m drape.engine.build --tests; exit $$failed

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright $(TYPED)
	$(BIN)/lint-imports
	$(BIN)/python scripts/audit.py --optional

audit: setup
	$(BIN)/python scripts/audit.py

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: setup
	@scripts/bench $(BIN)/python $(ARGS)

# The second line draws other requests and streams every time; what fails prints how to repeat it.
soak: setup
	$(BIN)/python -m benchmarks.soak --threads 1 $(ARGS)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q --hypothesis-profile=soak tests/service/http/test_openapi.py tests/service/stream/test_stream_machine.py

image:
	scripts/build_image $(ARGS)

# Every job puts its files into dist/, which the first one empties; the sums come last.
$(VENV)/.release-stamp: pyproject.toml | $(BIN)/python
	@DRAPE_ENGINE=apart scripts/timed "packages of a release" $(INSTALL) -e '.[release]'
	@touch $@

release: $(VENV)/.release-stamp
	scripts/build_page $(WEB)
	$(BIN)/kubernetes-validate --strict --quiet deploy/kubernetes.yaml
	$(BIN)/python scripts/release.py
	$(BIN)/python scripts/build_addon dist
	npm pack --silent --pack-destination dist ./$(WEB)/lib
	$(BIN)/python scripts/try_wheels.py
	WHEELS=dist OUT=dist scripts/build_image --optional
	cd dist && sha256sum -- * > SHA256SUMS

clean:
	rm -rf $(VENV) build dist *.egg-info .cache .pytest_cache .ruff_cache .hypothesis
	rm -rf $(WEB)/node_modules $(WEB)/dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
