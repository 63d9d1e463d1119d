# Two commands for everybody: `make demo`, `make test`. Two for whoever changes the code: `make check`, `make quick`.

PYTHON ?= python3
# An environment that somebody else made, with a plain installation say, stays as it is.
VENV := $(if $(and $(wildcard .venv),$(if $(wildcard .venv/ready .venv/by-make),,other)),build/venv,.venv)
BIN := $(VENV)/bin
READY := $(VENV)/ready
DEMO_OUT := build/demo
WARNINGS := -std=c99 -Wall -Wextra -Wconversion -Wfloat-equal -Wdouble-promotion -Werror -ffp-contract=off
# These need the headers that export writes; tests/export compiles them.
C_EXPORTED := %/example_main.c %/piezoid_controller.c %/fmu2.c
C_SOURCES := $(filter-out $(C_EXPORTED),$(wildcard piezoid/*.c piezoid/*/*.c))
C_FILES := $(wildcard piezoid/*.c piezoid/*/*.c piezoid/*/*.h)
# tests/ROOM for ROOM=..., or for each folder that differs from where this branch left main.
BASE = $(shell git merge-base HEAD origin/main 2>/dev/null || echo HEAD)
CHANGED = $(shell { git diff --name-only $(BASE); git ls-files --others --exclude-standard; } | \
  sed -nE 's#^(piezoid|tests)/([a-z_]+)/.*#tests/\2#p; s#^(cli|datasets|reports)/.*#tests/\1#p' | sort -u)
QUICK = $(wildcard $(or $(ROOM:%=tests/%),$(CHANGED)))

# Containers often disable bytecode: every command would then compile the package again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test quick check docs format benchmark clean

demo: $(READY)
	$(BIN)/piezoid demo --out $(DEMO_OUT) --force
	@echo 'Open $(DEMO_OUT)/report.html, compile $(DEMO_OUT)/bundle/'

test: $(READY)
	$(BIN)/python -m pytest -n 2 --dist worksteal -q

# The tests of a room that are not slow, for at most a minute: ROOM=diagnosis, or of every room that differs from main.
quick: $(READY)
	@test -n "$(QUICK)" || { echo 'No room differs from main. Name one, as in: make quick ROOM=diagnosis'; exit 2; }
	PIEZOID_QUICK_S=50 $(BIN)/python -m pytest -n 2 --dist worksteal -q -m "not slow" $(QUICK)

check: $(READY) build/names
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/clang-format --dry-run --Werror $(C_FILES)
	for source in $(C_SOURCES); do $(CC) $(WARNINGS) -fsyntax-only $$source || exit 1; done

# Warnings are errors. The pages of the effects and the outputs of all commands are made here.
docs: $(VENV)/docs-ready
	@echo 'Building the pages, about two minutes: all commands on them are run'
	$(BIN)/python -m sphinx -j 2 -W --keep-going -b html docs build/docs/html
	@echo 'Open build/docs/html/index.html'

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(C_FILES)

benchmark: $(READY)
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[benchmarks]'
	$(BIN)/python -m pytest benchmarks -q
	$(BIN)/python -m benchmarks.ratios
	$(BIN)/python -m benchmarks.streamed_fit 1e6 1e7
	$(BIN)/python -m benchmarks.fleet_summary 1000 10000 100000
	$(BIN)/python -m benchmarks.batch_client

# The environment: exactly the versions of constraints.txt, for the build as well.
$(READY): pyproject.toml constraints.txt $(C_FILES)
	@echo 'Making the environment in $(VENV)/, one to two minutes'
	test -x $(BIN)/python || { $(PYTHON) -m venv $(VENV) && touch $(VENV)/by-make; }
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[io,afm,batch,dev]'
	touch $@

$(VENV)/docs-ready: $(READY)
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	touch $@

# mypy reads folders, not import hooks: give it the installed names as links.
build/names: pyproject.toml
	mkdir -p $@
	for name in piezoid:piezoid cli:piezoid_cli datasets:piezoid_datasets reports:piezoid_reports; do \
	  ln -sfn "$(CURDIR)/$${name%%:*}" "$@/$${name##*:}"; done
	touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info
