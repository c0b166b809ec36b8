# make run: set up and let the knee walk. make test: set up and test. Needs Python 3.10+ and make.
VENV ?= .venv
PYTHON ?= python3
BIN := $(VENV)/bin
READY := $(VENV)/.ready
OWNER := $(VENV)/.made-by-make
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

# blind cases for the gap workflow; resumable, hours: see benchmarks/bench_gap.py
BENCH ?= bench_gap.jsonl
# of the tests: one more than there are cores, since many wait for other processes, and four at most
WORKERS ?= $(shell n=$$(nproc 2>/dev/null || echo 3); echo $$((n < 3 ? n + 1 : 4)))
# controllers compared; resumable, an hour or more: see benchmarks/bench_control.py
BENCH_CONTROL ?= bench_control.jsonl
# how fast it is, in ratios; minutes: see benchmarks/bench_speed.py
BENCH_SPEED ?= bench_speed.json
.PHONY: bench bench-gap bench-control setup run test paper docs docs-commands notebooks constraints clean

setup: $(READY)

# an environment that `make` did not create for this checkout is not changed
define GUARD
	@test ! -e $(VENV) || test "$$(cat $(OWNER) 2>/dev/null)" = "$(CURDIR)" || test $(VENV) = .venv -a -e $(READY) || \
	    { echo "$(VENV): make did not create this environment for this checkout; give another VENV" >&2; exit 2; }
endef

$(READY): setup.py pyproject.toml constraints.txt
	$(GUARD)
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 10) and 'Python 3.10 or newer is needed')"
	$(PYTHON) -m venv $(VENV)
	echo "$(CURDIR)" > $(OWNER)
	$(PIP) --editable '.[ros,test]'
	touch $@

run: setup
	$(BIN)/pam-orthosis run

test: setup
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest -n $(WORKERS) --max-worker-restart 0 --dist loadfile

bench: setup
	$(GUARD)
	$(PIP) --editable '.[ros,bench]'
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_speed.py run --out $(BENCH_SPEED)
	$(BIN)/python benchmarks/bench_speed.py table $(BENCH_SPEED)

bench-gap: setup
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_gap.py run --out $(BENCH)
	$(BIN)/python benchmarks/bench_gap.py table $(BENCH)

bench-control: setup
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_control.py run --out $(BENCH_CONTROL)
	$(BIN)/python benchmarks/bench_control.py table $(BENCH_CONTROL)

# figures and pictures of the page on the paper's results
paper: setup
	mkdir -p build
	$(BIN)/pam-orthosis paper --out build/paper --overwrite --json > build/paper.json
	mv build/paper.json benchmarks/results/paper.json
	cd build/paper/pictures && cp force.png observer.png tracking.png device.png rig.png mechanics.png ../../../docs/pictures

# the site in site/, without a warning; generated pages are made on the way
docs: setup
	$(BIN)/python docs/generate.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# the wheel, with the extra $(1), in a fresh environment
define FRESH
	rm -rf build/wheel build/fresh
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir build/wheel .
	$(PYTHON) -m venv build/fresh
	build/fresh/bin/python -m pip install --quiet --constraint constraints.txt "$$(echo build/wheel/*.whl)[$(1)]"
endef

# every command of the documentation that can run by itself, with the wheel in a fresh environment; takes long
docs-commands: setup
	$(call FRESH,ros)
	build/fresh/bin/python docs/commands.py --program build/fresh/bin/pam-orthosis $(COMMANDS)

# the notebooks, each from an empty folder, with the wheel in a fresh environment; minutes
notebooks: setup
	$(call FRESH,notebooks)
	build/fresh/bin/python docs/notebooks.py --check

constraints: setup
	$(BIN)/python .ci/constraints.py > constraints.new && mv constraints.new constraints.txt

clean:
	$(GUARD)
	rm -rf $(VENV) site build install log
