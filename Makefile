# make run: set up and let the knee walk. make test: set up and test. Needs Python 3.10+ and make.
VENV ?= .venv
PYTHON ?= python3
BIN := $(VENV)/bin
READY := $(VENV)/.ready

# blind cases for the gap workflow; resumable, hours: see benchmarks/bench_gap.py
BENCH ?= bench_gap.jsonl
# controllers compared; resumable, an hour or more: see benchmarks/bench_control.py
BENCH_CONTROL ?= bench_control.jsonl
# how fast it is, in ratios; minutes: see benchmarks/bench_speed.py
BENCH_SPEED ?= bench_speed.json
.PHONY: bench bench-gap bench-control setup run test picture docs docs-commands clean

setup: $(READY)

$(READY): setup.py pyproject.toml
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 10) and 'Python 3.10 or newer is needed')"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[ros,test]'
	touch $@

run: setup
	$(BIN)/pam-orthosis run

test: setup
	$(BIN)/ruff check .
	$(BIN)/python -m pytest

picture: setup
	$(BIN)/pam-orthosis report bags/walk --only picture --out docs/pictures --overwrite

bench: setup
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[ros,bench]'
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_speed.py run --out $(BENCH_SPEED)
	$(BIN)/python benchmarks/bench_speed.py table $(BENCH_SPEED)

bench-gap: setup
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_gap.py run --out $(BENCH)
	$(BIN)/python benchmarks/bench_gap.py table $(BENCH)

bench-control: setup
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_control.py run --out $(BENCH_CONTROL)
	$(BIN)/python benchmarks/bench_control.py table $(BENCH_CONTROL)

# generated pages, then the site in site/, without a warning
docs: setup
	$(BIN)/python docs/generate.py
	$(BIN)/mkdocs build --strict

# every command of the documentation that can run by itself; takes long
docs-commands: setup
	$(BIN)/python docs/commands.py

clean:
	rm -rf $(VENV) site build install log
