# make demo, make test: from a fresh clone, with Python 3.11 or newer and nothing else.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMPS := $(VENV)/.stamps
PACKAGES := protocol runtime controller_service plant_service tap_service attacker_service wyner studies benchmarks tools
NODEPS := --quiet --disable-pip-version-check --no-deps --no-build-isolation

ROOM_TARGETS := test-protocol test-runtime test-controller test-plant test-tap test-attacker test-wyner test-studies test-house
.PHONY: $(ROOM_TARGETS)
.PHONY: demo dev test tests test-long test-fast test-compose test-pythons coverage lint docs figures paper bench campaign lock clean help

help:
	@echo "make demo          controller, plant and tap on this machine; a message; a screen"
	@echo "make test          the tests but for the long ones, with ruff and mypy; ALL=1: the long ones too"
	@echo "make test-long     the long ones: many runs, benchmarks, the campaigns' short forms"
	@echo "make test-fast     the tests without the slow ones"
	@echo "make test-ROOM     the tests of one room: protocol, runtime, controller, plant,"
	@echo "                   tap, attacker, wyner, studies, house"
	@echo "make test-pythons  a part of the tests on every other Python at hand"
	@echo "make test-compose  the tests of the containers (a Docker engine must run)"
	@echo "make coverage      branch coverage of each room; protocol/ at 95 % or more"
	@echo "make dev           $(VENV) with all that the tests need"
	@echo "make lint          ruff and mypy"
	@echo "make docs          the documents and the API reference as a site, in build/docs"
	@echo "make figures       every figure of docs/ from its data"
	@echo "make paper         paper/paper.pdf from its text and the project's data"
	@echo "make bench         every benchmark"
	@echo "make campaign      try to break exactly once, for hours (docs/protocol.md)"
	@echo "make lock          pin the dependencies anew, with hashes"

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

# What running needs, pinned and checked by hash; then the project itself.
$(STAMPS)/runtime: requirements/runtime.txt pyproject.toml | $(VENV)/bin/python
	@echo "installing into $(VENV): half a minute, once"
	deploy/pinned $(VENV) requirements/runtime.txt
	$(BIN)/pip install $(NODEPS) --editable .
	@mkdir -p $(STAMPS) && touch $@

# What testing needs; it contains all that running needs.
$(STAMPS)/dev: requirements/dev.txt pyproject.toml | $(VENV)/bin/python
	@echo "installing what the tests need into $(VENV): a minute, once"
	deploy/pinned $(VENV) requirements/dev.txt
	$(BIN)/pip install $(NODEPS) --editable .
	@mkdir -p $(STAMPS) && touch $@ $(STAMPS)/runtime

demo: $(STAMPS)/runtime
	$(BIN)/wyner up --demo

dev: $(STAMPS)/dev

lint: $(STAMPS)/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy $(PACKAGES) tests

# The linters are one process, and the tests as many as there are cores: beside each other.
test: $(STAMPS)/dev
	@$(MAKE) --no-print-directory --jobs=2 lint tests

# Each process has a core already: a second thread of the numerics would take another's.
tests test-long test-fast test-pythons coverage $(ROOM_TARGETS): export OPENBLAS_NUM_THREADS := 1

# With ALL=1 the long tests too, in one run: what all share is made once.
tests: $(STAMPS)/dev
	$(BIN)/pytest $(if $(ALL),,-m "not long") -n auto --dist loadfile --no-loadscope-reorder

test-long: $(STAMPS)/dev
	$(BIN)/pytest -m long -n auto --dist loadfile --no-loadscope-reorder

# Needs a Docker engine; says how to get one where none runs.
test-compose: $(STAMPS)/dev
	$(BIN)/pytest tests/compose

test-fast: $(STAMPS)/dev
	$(BIN)/pytest -m "not slow" -n auto --dist loadfile --no-loadscope-reorder

ROOM_protocol := protocol defence link schemes secret
ROOM_runtime := runtime
ROOM_controller := controller
ROOM_plant := adapters
ROOM_tap := tap
ROOM_attacker := attacker
ROOM_wyner := advice api cli dashboard deployment fit runs simulate sweeps system
ROOM_studies := studies
ROOM_house := house benchmarks campaigns examples tools

$(ROOM_TARGETS): test-%: $(STAMPS)/dev
	$(BIN)/pytest -n auto --dist loadfile $(wildcard $(ROOM_$*:%=tests/%))

test-pythons: $(STAMPS)/dev
	deploy/other-pythons

# Lines and branches that the tests reach, room by room; also where a test failed, and then it fails.
coverage: $(STAMPS)/dev
	$(BIN)/pip install --quiet --disable-pip-version-check "coverage>=7.10"
	@mkdir -p build/coverage
	$(BIN)/coverage erase
	@$(BIN)/coverage run -m pytest -n auto --dist loadfile --no-loadscope-reorder; tests=$$?; \
	$(BIN)/coverage combine --quiet; \
	for room in protocol/schemes protocol/link protocol/secret runtime protocol/scenario \
	  controller_service plant_service tap_service attacker_service wyner; do \
	  printf '%s %s %%\n' $$room $$($(BIN)/coverage report --format=total --precision=1 --include "$$room/*"); done; \
	$(BIN)/coverage report --format=total --include "protocol/*" --fail-under 95 && exit $$tests

# Every page and the API reference as a site; a broken link is an error.
docs: $(STAMPS)/dev
	@echo "building build/docs: minutes for the API reference, the first time"
	$(BIN)/python -m sphinx -W --keep-going -j auto -b html docs build/docs
	@echo "build/docs/index.html"

figures: $(STAMPS)/dev
	$(BIN)/python -m studies figures

paper: $(STAMPS)/dev
	$(BIN)/python -m tools.paper

# Hours. See docs/protocol.md.
CAMPAIGN := $(BIN)/python -m tests.campaigns
campaign: $(STAMPS)/dev
	$(CAMPAIGN).exhaustive --scheme switched --seconds 7200
	$(CAMPAIGN).exhaustive --scheme pipelined --seconds 7200
	$(CAMPAIGN).schedules
	$(CAMPAIGN).kills
	$(CAMPAIGN).kills --keys
	$(CAMPAIGN).kills --tls --kills 240
	$(CAMPAIGN).kills --watched
	WYNER_TESTS=whole $(MAKE) tests ALL=1

bench: $(STAMPS)/dev
	$(BIN)/python -m benchmarks all

lock:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet uv
	echo uv | $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
	  --no-header --no-emit-index-url --upgrade - -o requirements/uv.txt
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
	  --no-header --no-emit-index-url --upgrade pyproject.toml -o requirements/runtime.txt
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
	  --no-header --no-emit-index-url --upgrade --extra dev -c requirements/runtime.txt \
	  pyproject.toml -o requirements/dev.txt

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
