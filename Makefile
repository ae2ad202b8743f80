# Needs python3 (3.11 or newer, with venv), make and git. Everything else comes from requirements.lock into .venv.
PYTHON ?= python3
ARGS ?=
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip -qq --disable-pip-version-check --no-input
PYTEST := $(BIN)/python -m pytest

# One thread per process: tests run side by side, and benchmarks count CPU seconds. More of them than cores, as many wait.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
# Tests start Python hundreds of times: what it compiles is kept, whatever the environment says.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test test-all test-long test-maps ways-out crash faults pits rehearsals replies model coverage shop-campaign mutate soak interop check format reference docs paper screenshots bench performance compare claims naming scenarios robustness robustness-dask lock dist dist-check image-check clean

help: ## show this list
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 12

demo: $(VENV)/.installed ## polish a simulated part, from the first map to the report (ARGS="...")
	@$(BIN)/polishd demo $(ARGS)

test: $(VENV)/.installed ## run one test of each kind (ARGS="...")
	@$(ONE_THREAD) $(PYTEST) -n 4 --dist worksteal -m "not full and not slow and not hil" $(ARGS)

test-all: $(VENV)/.installed ## run all tests except the long campaigns and the interop tests (ARGS="...")
	@$(ONE_THREAD) $(PYTEST) -n 3 --dist worksteal -m "not slow and not hil" --ignore=tests/interop $(ARGS)

# Those that run machines in real time by themselves, and first: others would starve what they simulate.
REAL_TIME := tests/campaigns/test_ways_out.py tests/campaigns/crash tests/campaigns/soak tests/system
test-long: $(VENV)/.installed ## run the long campaigns (ARGS="...")
	@$(ONE_THREAD) $(PYTEST) -n 1 -m "slow and not hil" $(REAL_TIME) $(ARGS)
	@$(ONE_THREAD) $(PYTEST) -n 2 --dist worksteal -m "slow and not hil" $(REAL_TIME:%=--ignore=%) $(ARGS)

test-maps: $(VENV)/.installed ## read 100,000 broken files of each map format; 10,000 writes into the maps folder
	@$(ONE_THREAD) $(PYTEST) -n 3 --dist worksteal -m slow tests/unit/plugins/interferometer/test_map_fuzz.py tests/campaigns/test_folder_campaign.py $(ARGS)

ways-out: $(VENV)/.installed ## run every way out of contact in real time; table in docs/reference/results.md
	@$(ONE_THREAD) $(PYTEST) -n 3 --dist worksteal -m slow tests/campaigns/test_ways_out.py $(ARGS)
	@$(BIN)/python -m tests.campaigns.ways_out

crash: $(VENV)/.installed ## try 100,000 crash states of the journal, 2,000 kills, and its model; into docs/reference/results.md (ARGS="...")
	@$(ONE_THREAD) $(BIN)/python -m tests.campaigns.crash $(ARGS)

faults: $(VENV)/.installed ## inject every fault on every link in contact; into docs/reference/results.md, can be continued (ARGS="--minutes 30 --jobs 3")
	@$(ONE_THREAD) $(BIN)/python -m tests.campaigns.faults $(ARGS)

pits: $(VENV)/.installed ## measure the depth beyond plan of stopped or slow robots and wrong forces; into docs/reference/results.md, can be continued (ARGS="--json")
	@$(ONE_THREAD) $(BIN)/python -m tests.campaigns.pits $(ARGS)

rehearsals: $(VENV)/.installed ## rehearse every example cell to its tolerance (ARGS="--cell abb_cell.toml")
	@$(ONE_THREAD) $(BIN)/python -m tests.campaigns.rehearsals $(ARGS)

replies: $(VENV)/.installed ## send a million malformed or late replies to each driver; into docs/reference/results.md, can be continued (ARGS="--minutes 20")
	@$(ONE_THREAD) $(BIN)/python -m tests.campaigns.codecs $(ARGS)

model: $(VENV)/.installed ## check the model of the journal's protocol
	@$(ONE_THREAD) $(BIN)/python -m tests.campaigns.crash --states 0 --kills 0 $(ARGS)

coverage: $(VENV)/.installed ## check that a test runs every branch of state machine, journal, recovery and safety
	@$(ONE_THREAD) $(BIN)/python -m tests.campaigns.mutation.covered $(ARGS)

shop-campaign: $(VENV)/.installed ## run parts through three cells and a shop with random kills; into docs/reference/results.md, can be continued (ARGS="--minutes 30")
	@$(ONE_THREAD) $(BIN)/python -m tests.campaigns.shop $(ARGS)

mutate: $(VENV)/.installed ## check that a test finds each small fault in these modules; into docs/reference/results.md (ARGS="touch safety")
	@$(ONE_THREAD) $(BIN)/python -m tests.campaigns.mutation $(ARGS)

soak: $(VENV)/.installed ## run 931 parts through the queue of simulated cells; into docs/reference/results.md (ARGS="...")
	@$(ONE_THREAD) $(BIN)/python -m tests.campaigns.soak $(ARGS)

# Peers are no part of polishd: they have a venv of their own, and what cannot be fetched is skipped by its name.
INTEROP := build/interop
interop: $(VENV)/.installed ## test all links with third-party peers; into docs/reference/interop.md
	@$(MAKE) --no-print-directory -k $(INTEROP)/venv/.installed $(INTEROP)/node_modules/.installed || \
	    echo "NOT ALL PEERS: some cannot be fetched here, and their tests are skipped" >&2
	@$(ONE_THREAD) $(BIN)/python -m tests.interop $(ARGS)

$(INTEROP)/venv/.installed: tests/interop/requirements.txt $(VENV)/.locked
	@echo "making $(INTEROP)/venv from tests/interop/requirements.txt" >&2
	@$(BIN)/python -m venv --clear $(INTEROP)/venv
	@$(INTEROP)/venv/bin/python -m pip -qq --disable-pip-version-check --no-input install -r $<
	@touch $@

$(INTEROP)/node_modules/.installed: tests/interop/package-lock.json
	@echo "making $(INTEROP)/node_modules from tests/interop/package-lock.json" >&2
	@mkdir -p $(INTEROP) && cp tests/interop/package.json tests/interop/package-lock.json $(INTEROP)/
	@cd $(INTEROP) && npm ci --ignore-scripts --no-audit --no-fund --loglevel=error
	@touch $@

check: $(VENV)/.installed ## check lint, format, types, layers and wording
	@$(BIN)/ruff check --quiet .
	@$(BIN)/ruff format --check --quiet .
	@$(BIN)/mypy
	@$(PYTEST) --quiet --quiet tests/arch/test_tree.py

format: $(VENV)/.installed ## format the sources and apply the linter's fixes
	@$(BIN)/ruff check --quiet --fix-only .
	@$(BIN)/ruff format --quiet .

reference: $(VENV)/.installed ## write docs/reference (config keys, ports, command line), JSON Schemas and the man page docs/polishd.1 from the source
	@$(BIN)/python -m docs.reference.write
	@$(BIN)/python -m docs.reference.code_tables
	@$(BIN)/python -m docs.reference.schemas
	@$(BIN)/python -m docs.reference.man
	@$(BIN)/python -m docs.reference.cli

# Sphinx is no part of polishd: it has a venv of its own, which also imports from $(VENV) for the API reference.
DOCS := build/docs-venv
SPHINX := -E -W --keep-going -q -b html docs build/docs
docs: $(DOCS)/.installed $(VENV)/.installed ## build the documentation site, warnings as errors; into build/docs/index.html
	@$(DOCS)/bin/python -m sphinx $(SPHINX) $(ARGS)

$(DOCS)/.installed: docs/requirements.lock $(VENV)/.locked
	@echo "making $(DOCS) from docs/requirements.lock" >&2
	@$(BIN)/python -m venv --clear $(DOCS)
	@$(DOCS)/bin/python -m pip -qq --disable-pip-version-check --no-input install --require-hashes -r $<
	@site() { "$$1" -c 'import sysconfig; print(sysconfig.get_path("purelib"))'; }; \
	    site $(BIN)/python > "$$(site $(DOCS)/bin/python)/polishd.pth"
	@touch $@

PAPER := build/paper
paper: $(VENV)/.installed ## draw the pictures of docs/explanation/paper.md again
	@for study in table_iii table_iv fig_12; do \
	    $(ONE_THREAD) $(BIN)/polishd study examples/$$study.toml --out $(PAPER)/$$study >/dev/null || exit; done
	@$(BIN)/polishd compliance examples/cell.toml --out docs/images/paper/fig_10.png >/dev/null
	@$(BIN)/polishd tif examples/cell.toml --out docs/images/paper/spot.png >/dev/null
	@cp $(PAPER)/table_iii/profiles_radius.png docs/images/paper/table_iii.png
	@cp $(PAPER)/table_iv/residuals_depth.png docs/images/paper/table_iv.png
	@cp $(PAPER)/table_iv/setting.png docs/images/paper/fig_13.png
	@cp $(PAPER)/fig_12/passes.png docs/images/paper/fig_12.png

screenshots: $(VENV)/.installed ## make the pictures of the page in docs/images/page; needs chromium (ARGS="name ...")
	@$(BIN)/python -m tests.screenshots $(ARGS)

bench: $(VENV)/.installed ## compare polishd with its peers; into docs/data/benchmarks.jsonl (ARGS="name ...")
	@$(ONE_THREAD) $(BIN)/python -m benchmarks $(ARGS)

performance: $(VENV)/.installed ## write docs/data/benchmarks.jsonl into docs/reference/results.md
	@$(BIN)/python -m docs.reference.performance
	@$(BIN)/python -m docs.reference.cost

claims: $(VENV)/.installed ## list the figures of README and docs, fresh or stale; fails where a page differs (ARGS="--record CLAIM KEY=FIGURE")
	@$(BIN)/python -m tests.campaigns.claims $(ARGS)

COMPARED = --limit 24
compare: $(VENV)/.installed ## compare the compliance corrections on parts of 100 and 300 mm (COMPARED="--limit N")
	@$(ONE_THREAD) $(BIN)/polishd study examples/corrections.toml --out build/compare/100 $(COMPARED)
	@$(ONE_THREAD) $(BIN)/polishd study examples/corrections_300.toml --out build/compare/300 $(COMPARED)

naming: $(VENV)/.installed ## continue the study of the diagnosis; into docs/reference/results.md (ARGS="--workers 2")
	@$(ONE_THREAD) $(BIN)/polishd study examples/naming.toml --out build/naming $(ARGS)
	@$(BIN)/python -m docs.reference.naming build/naming

scenarios: $(VENV)/.installed ## continue the study of one fault at a time in three loops; into docs/reference/results.md (ARGS="--limit N")
	@$(ONE_THREAD) $(BIN)/polishd study examples/scenarios.toml --out build/scenarios $(ARGS)
	@$(BIN)/python -m docs.reference.scenarios build/scenarios

robustness: $(VENV)/.installed ## continue the study of 2,200 jobs on varied machines with each correction; into docs/reference/results.md
	@$(ONE_THREAD) $(BIN)/polishd study examples/robustness.toml --out build/robustness $(ARGS)
	@$(BIN)/python -m docs.reference.robustness build/robustness

robustness-dask: $(VENV)/.installed ## run the same on a Dask cluster that loses a worker; must be equal to the bit; into docs/reference/results.md (ARGS="--limit N")
	@$(ONE_THREAD) $(BIN)/python -m tests.campaigns.cluster $(ARGS)

# The lock is changed only here. --upgrade in ARGS takes newer versions; without it only what pyproject.toml asks for.
lock: ## rewrite requirements.lock and docs/requirements.lock (ARGS=--upgrade for newer versions)
	@$(PYTHON) -m venv --clear build/uv
	@build/uv/bin/python -m pip -qq --disable-pip-version-check install 'uv>=0.9,<1'
	@build/uv/bin/uv --quiet pip compile pyproject.toml --extra all --group dev --output-file requirements.lock \
	    --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
	    --no-header --no-emit-index-url --no-emit-find-links $(ARGS)
	@build/uv/bin/uv --quiet pip compile docs/requirements.in --constraints requirements.lock \
	    --output-file docs/requirements.lock --universal --python-version 3.11 --fork-strategy fewest \
	    --generate-hashes --no-header --no-emit-index-url --no-emit-find-links $(ARGS)
	@rm -rf build/uv

# Two builds of one commit are the same to the byte: files have the commit's time. Hatchling comes from the lock.
SOURCE_DATE_EPOCH ?= $(shell git log -1 --format=%ct 2>/dev/null || echo 1577836800)
dist: $(VENV)/.installed ## build sdist and wheel into dist/
	@rm -rf dist
	@SOURCE_DATE_EPOCH=$(SOURCE_DATE_EPOCH) $(BIN)/python -m hatchling build -d dist

dist-check: dist ## build twice, compare, install the wheel into an empty environment and make a first plan with it
	@SOURCE_DATE_EPOCH=$(SOURCE_DATE_EPOCH) $(BIN)/python -m tests.release.dist dist

image-check: $(VENV)/.installed ## build the container image and run it; without podman or docker check the Containerfile
	@$(BIN)/python -m tests.release.image

clean: ## remove all generated files
	@rm -rf $(VENV) build dist .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

# A changed lock starts from an empty environment, so that nothing unlocked lingers; a changed pyproject.toml only
# renews our own entry points. Without a folder that keeps compiled code the first large plan compiles it. The tests are
# compiled beside it, on the other core: otherwise each worker of the first make test compiles them all.
$(VENV)/.locked: requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "polishd needs Python 3.11 or newer, and $(PYTHON) is not: make PYTHON=python3.11 ..." >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	    { echo "$(PYTHON) cannot make environments: install its venv (on Debian: apt-get install python3-venv)" >&2; exit 1; }
	@echo "making $(VENV) from requirements.lock" >&2
	@$(PYTHON) -m venv --clear $(VENV)
	@$(PIP) install --require-hashes -r requirements.lock
	@touch $@

$(VENV)/.installed: $(VENV)/.locked pyproject.toml
	@$(PIP) install --no-deps --no-build-isolation --editable .
	@$(BIN)/python -m compileall -q -j 0 polishd
	@echo "compiling the functions of large plans, and the tests" >&2
	@$(PYTEST) --collect-only -qq >/dev/null & \
	    $(BIN)/polishd doctor --compile >&2 || \
	    echo "not compiled: the first large plan compiles them; $(BIN)/polishd doctor --compile tries again" >&2; \
	    wait $$! || echo "the tests cannot be collected: make test shows why" >&2
	@touch $@
