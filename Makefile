# Works as the first command typed on a machine with Python 3.11 or later, make, gcc and git.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PARALLEL := -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder
DEMO := logs/runs/demo
PICTURES := logs/runs/pictures
EVENTS := change brake worn
EVENT_OPTIONS := --size 640x480 --seconds 5 --tag-noise 0.02 --depth-noise 0.01 --force
SAMPLE_DUMP := logs/runs/sample-dump
SAMPLE_OPTIONS := --scene town --size 360x270 --seconds 2 --tag-noise 0.01 --depth-noise 0.002 --jpeg

EVENT_LOGS := $(EVENTS:%=$(PICTURES)/%.mcap)

.PHONY: $(EVENT_LOGS) demo test test-hostile mutants accuracy accuracy-long kills cluster parts bench bench-long bench-compare bench-report image fuzz lint pages proto sample pictures docs clean

$(VENV)/.installed: pyproject.toml setup.py $(wildcard roadperc_stream/*/*.pyx roadperc_stream/*/*/*.pyx)
	@echo "installing into $(VENV), compiling inner loops: a minute or two"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

demo: $(VENV)/.installed
	@mkdir -p $(DEMO)
	$(BIN)/roadperc-replay logs/sample.mcap $(DEMO)/sample.mcap --force
	$(BIN)/roadperc-report $(DEMO)/sample.metrics.parquet --worst 1
	@echo
	@echo "log with results   $(DEMO)/sample.mcap             (see it: $(BIN)/roadperc-view $(DEMO)/sample.mcap)"
	@echo "a row per frame    $(DEMO)/sample.metrics.parquet"
	@echo "a row per object   $(DEMO)/sample.objects.parquet"

TESTS ?=
test: $(VENV)/.installed  # all, or those that pytest takes with TESTS, such as TESTS=tests/cli
	$(BIN)/python -m pytest $(PARALLEL) $(TESTS)

test-hostile: $(VENV)/.installed  # the tests that run commands, on a machine unlike a developer's
	.ci/in-hostile-environment $(BIN)/python -m pytest $(PARALLEL) -m 'commands and not accuracy' \
		--deselect tests/test_docs.py::test_every_command_runs_in_order

N ?= 200
SEED ?= 1
JOBS ?= $(shell nproc)
mutants: $(VENV)/.installed  # small faults in the code: are they noticed? A quarter of an hour, the first time a half
	$(BIN)/python -m tests.mutants --count $(N) --seed $(SEED) --jobs $(JOBS)

fuzz: N = 2000
fuzz: $(VENV)/.installed  # inputs that are wrong in some place, to every command: make fuzz N=20000 SEED=2
	$(BIN)/python -m tests.fuzz --count $(N) --seed $(SEED) --jobs $(JOBS)

SEEDS ?= 4
PAGE ?=
accuracy: $(VENV)/.installed  # every figure, required beside measured: make accuracy SEEDS=2, PAGE=docs/accuracy.md writes it
	$(BIN)/python -m tests.accuracy --seeds $(SEEDS) --jobs $(JOBS) $(if $(PAGE),--page $(PAGE))

accuracy-long: $(VENV)/.installed  # the tests of accuracy at full size
	$(BIN)/python -m pytest -m accuracy -s

KILLS ?= 100
kills: $(VENV)/.installed  # a replay with checkpoints is killed so often at random moments: are its files the same?
	KILLS=$(KILLS) $(BIN)/python -m pytest -m accuracy -s tests/resume/test_kills.py

cluster: $(VENV)/.installed  # a batch on a Ray cluster of two machines, from outside too, and workers killed at random
	$(BIN)/python -m pytest -m 'accuracy or not accuracy' tests/batch/test_cluster.py tests/batch/test_chaos.py

PARTS ?= 500
parts: $(VENV)/.installed  # drives cut at so many random places: are the results of the parts those of the whole?
	PARTS=$(PARTS) $(BIN)/python -m pytest -m accuracy -s tests/resume/test_parts.py

BENCH := logs/runs/bench
BENCH_OPTIONS ?=
bench bench-long bench-compare: export PYTHONDONTWRITEBYTECODE :=  # a start that compiles every module is none of a user's
bench: $(VENV)/.installed  # how fast a replay is, beside the course's method: make bench BENCH_OPTIONS='--json bench.json'
	$(BIN)/python -m roadperc_stream.tools.bench $(BENCH) $(BENCH_OPTIONS)

bench-long: $(VENV)/.installed  # memory and encoding over 3000 frames: a quarter of an hour, and 5 GB
	$(BIN)/python -m roadperc_stream.tools.bench $(BENCH) --long-frames 3000 $(BENCH_OPTIONS)

bench-compare: $(VENV)/.installed  # what is slower than at a commit: make bench-compare BASE=main
	@test -n "$(BASE)" || { echo "make bench-compare BASE=<commit>"; exit 2; }
	$(BIN)/python -m roadperc_stream.tools.bench.compare $(BENCH) $(BASE) $(BENCH_OPTIONS)

bench-report: $(VENV)/.installed  # writes 5 GB; the bare group-by wants 8 GB of memory
	$(BIN)/python -m roadperc_stream.tools.bench.report logs/runs/bench-report

ENGINE ?= docker
IMAGE ?= roadperc
image:  # wants a container engine; runs roadperc-batch as head, worker or alone
	$(ENGINE) build --file docker/Dockerfile --tag $(IMAGE) .
	$(ENGINE) run --rm $(IMAGE) --version

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

proto: $(VENV)/.installed
	$(BIN)/python -m grpc_tools.protoc --proto_path=. --plugin=protoc-gen-mypy=$(BIN)/protoc-gen-mypy \
		--python_out=. --mypy_out=. roadperc_stream/schemas/roadperc.proto

pages: $(VENV)/.installed  # the tables of docs/ that are made from the code
	$(BIN)/python -m roadperc_stream.eval.metrics_page docs/metrics.md docs/scaling.md
	$(BIN)/python -m roadperc_stream.cli.settings > docs/settings.md
	$(BIN)/python -m tests.promises
	$(BIN)/python -m tests.errors_page

sample: $(VENV)/.installed
	$(BIN)/roadperc-render $(SAMPLE_DUMP) $(SAMPLE_OPTIONS) --force
	$(BIN)/roadperc-convert $(SAMPLE_DUMP) logs/sample.mcap --force

docs: $(VENV)/.installed  # build/site, with the API reference; a dead link is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

pictures: $(VENV)/.installed $(EVENT_LOGS)  # those of docs/ but foxglove.png and rerun.jpg; chromium shows the report
	$(BIN)/roadperc-render $(PICTURES)/drive --scene town --seconds 2.2 --force
	$(BIN)/roadperc-convert $(PICTURES)/drive $(PICTURES)/town.mcap --force --quiet
	$(BIN)/roadperc-replay $(PICTURES)/town.mcap $(PICTURES)/result.mcap --overlay --force
	$(BIN)/roadperc-report $(PICTURES)/result.metrics.parquet --html $(PICTURES)/report.html
	$(BIN)/python docs/make_pictures.py report $(PICTURES)/result.mcap $(PICTURES)/report.html
	$(BIN)/python docs/make_pictures.py frames $(PICTURES)/change.mcap docs/lane_change.jpg 67 76
	$(BIN)/python docs/make_pictures.py frames $(PICTURES)/brake.mcap docs/braking.jpg 63 78
	$(BIN)/python docs/make_pictures.py frames $(PICTURES)/worn.mcap docs/worn.jpg 38 54

$(PICTURES)/change.mcap: EVENT := --scene town --change-lane left --seed 113
$(PICTURES)/brake.mcap: EVENT := --scene town --lead-brakes --seed 101
$(PICTURES)/worn.mcap: EVENT := --scene straight --worn-lines 15,40 --seed 120
$(EVENT_LOGS): $(PICTURES)/%.mcap: $(VENV)/.installed
	$(BIN)/roadperc-render $(PICTURES)/$*-drive $(EVENT) $(EVENT_OPTIONS)
	$(BIN)/roadperc-convert $(PICTURES)/$*-drive $(PICTURES)/$*-input.mcap --force --quiet
	$(BIN)/roadperc-replay $(PICTURES)/$*-input.mcap $@ --overlay --force

clean:
	rm -rf $(VENV) $(DEMO) build dist *.egg-info
	rm -f $(foreach folder,chain/kernels system,$(addprefix roadperc_stream/$(folder)/*.,c so pyd))
