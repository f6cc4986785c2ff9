# Every target works on a fresh machine with Python 3.11 or later, make, gcc and git.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install -qq --disable-pip-version-check --no-compile
# Tests of locks and signals wait, hence a worker more than cores. A worker that crashes ends the run with an error;
# replaced workers can hang.
PARALLEL := -n $(shell expr $$(nproc) + 1) --maxprocesses 4 --dist loadfile --no-loadscope-reorder --max-worker-restart=0
DEMO := logs/runs/demo
PICTURES := logs/runs/pictures
COURSE := $(PICTURES)/course
EVENTS := change brake worn
EVENT_OPTIONS := --size 640x480 --seconds 5 --tag-noise 0.02 --depth-noise 0.01 --force
SAMPLE_DUMP := logs/runs/sample-dump
SAMPLE_OPTIONS := --scene town --size 360x270 --seconds 2 --tag-noise 0.01 --depth-noise 0.002 --jpeg

EVENT_LOGS := $(EVENTS:%=$(PICTURES)/%.mcap)

.PHONY: $(EVENT_LOGS) demo test test-long test-hostile mutants accuracy accuracy-long gate-rates hindsight-rates kills cluster parts bench bench-compare bench-report image fuzz lint pages proto sample pictures docs clean

# uv is three times as fast as pip, but reads no settings of pip: where it finds no packages, pip installs.
$(VENV)/.installed: pyproject.toml setup.py $(wildcard roadperc_stream/*/*.pyx)
	@echo "installing into $(VENV), compiling inner loops: about a minute"
	$(PYTHON) -m venv $(VENV)
	$(PIP) 'uv>=0.13,<1' && $(BIN)/uv pip install --quiet --system-certs --python $(BIN)/python --editable '.[dev]' || \
		$(PIP) --editable '.[dev]'
	@touch $@

demo: $(VENV)/.installed
	@mkdir -p $(DEMO)
	$(BIN)/roadperc-replay logs/sample.mcap $(DEMO)/sample.mcap --force
	$(BIN)/roadperc-report $(DEMO)/sample.metrics.parquet --worst 1
	@echo
	$(BIN)/roadperc-check $(DEMO)/sample.metrics.parquet
	@echo
	@echo "log with results   $(DEMO)/sample.mcap             (see it: $(BIN)/roadperc view $(DEMO)/sample.mcap)"
	@echo "a row per frame    $(DEMO)/sample.metrics.parquet"
	@echo "a row per object   $(DEMO)/sample.objects.parquet"

TESTS ?=
test test-long: export PYTHONDONTWRITEBYTECODE :=  # hundreds of tests start commands, which would compile all modules
test: $(VENV)/.installed  # all tests except the long ones, or those of TESTS=tests/cli
	$(BIN)/python -m pytest $(PARALLEL) -m 'not accuracy and not long' $(TESTS)

test-long: $(VENV)/.installed  # rendered scenes, killed replays, the commands of all pages: 4 minutes
	$(BIN)/python -m pytest $(PARALLEL) -m 'long and not accuracy' $(TESTS)

HOSTILE := tests/hostile/test_terminal.py tests/info tests/batch/test_lock.py tests/eval/report/test_report.py \
	tests/resume/test_resume.py tests/tools/test_conversion.py tests/view/rerun/test_saving.py
test-hostile: $(VENV)/.installed  # tests of reading, writing and printing, in an unusual environment
	.ci/in-hostile-environment $(BIN)/python -m pytest $(PARALLEL) -m 'commands and not accuracy and not long' $(HOSTILE)

N ?= 200
SEED ?= 1
JOBS ?= $(shell nproc)
mutants: $(VENV)/.installed  # adds small faults to the code and lists those that no test notices: 15 minutes, the first run 30
	$(BIN)/python -m tests.mutants --count $(N) --seed $(SEED) --jobs $(JOBS)

fuzz: N = 200
fuzz: $(VENV)/.installed  # gives every command wrong input, N for each test of tests/fuzz: make fuzz N=1000
	FUZZ=$(N) $(BIN)/python -m pytest -n $(JOBS) tests/fuzz

SEEDS ?= 4
PAGE ?=
accuracy: $(VENV)/.installed  # required and measured accuracy: make accuracy SEEDS=2; PAGE=docs/accuracy.md updates the page
	$(BIN)/python -m tests.accuracy --seeds $(SEEDS) --jobs $(JOBS) $(if $(ONLY),--only "$(ONLY)") $(if $(PAGE),--page $(PAGE))

gate-rates: $(VENV)/.installed  # how often compare is wrong, an hour on two cores; PAGE=docs/evaluation.md updates the page
	$(BIN)/python -m tests.gate_rates logs/runs/gate-rates --jobs $(JOBS) $(if $(PAGE),--page $(PAGE))

hindsight-rates: $(VENV)/.installed  # how far errors by hindsight can be believed, an hour on two cores; PAGE=docs/hindsight.md updates the page
	$(BIN)/python -m tests.hindsight_rates logs/runs/hindsight-rates --jobs $(JOBS) $(if $(PAGE),--page $(PAGE))

accuracy-long: $(VENV)/.installed  # the accuracy tests at full size
	$(BIN)/python -m pytest -m accuracy -s

KILLS ?= 100
kills: $(VENV)/.installed  # kills a replay with checkpoints at KILLS random times and compares its files
	KILLS=$(KILLS) $(BIN)/python -m pytest -m accuracy -s tests/resume/test_kills.py

cluster: $(VENV)/.installed  # batches on a Ray cluster of two machines, with workers killed at random
	$(BIN)/python -m pytest -m 'accuracy or not accuracy' tests/batch/test_cluster.py tests/batch/test_chaos.py

PARTS ?= 500
parts: $(VENV)/.installed  # cuts logs at PARTS random places and compares the continued replays with the whole
	PARTS=$(PARTS) $(BIN)/python -m pytest -m accuracy -s tests/resume/test_continued.py

BENCH := logs/runs/bench
BENCH_OPTIONS ?=
bench bench-compare: export PYTHONDONTWRITEBYTECODE :=  # users start with compiled modules
bench: $(VENV)/.installed  # speed of a replay and of the course's method: make bench BENCH_OPTIONS='--json bench.json'
	$(BIN)/python -m roadperc_stream.tools.bench $(BENCH) $(BENCH_OPTIONS)

bench-compare: $(VENV)/.installed  # compares the speed with a commit: make bench-compare BASE=main
	@test -n "$(BASE)" || { echo "make bench-compare BASE=<commit>"; exit 2; }
	$(BIN)/python -m roadperc_stream.tools.bench.compare $(BENCH) $(BASE) $(BENCH_OPTIONS)

bench-report: $(VENV)/.installed  # speed of reports: writes 6 GB, needs 10 GB of memory
	$(BIN)/python -m roadperc_stream.tools.bench.report logs/runs/bench-report

ENGINE ?= docker
IMAGE ?= roadperc
image:  # needs a container engine; the image runs roadperc-batch alone, as head or as worker
	$(ENGINE) build --file docker/Dockerfile --tag $(IMAGE) .
	$(ENGINE) run --rm $(IMAGE) --version

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

proto: $(VENV)/.installed
	$(BIN)/python -m grpc_tools.protoc --proto_path=. --plugin=protoc-gen-mypy=$(BIN)/protoc-gen-mypy \
		--python_out=. --mypy_out=. roadperc_stream/schemas/roadperc.proto

pages: $(VENV)/.installed  # the generated pages and tables of docs/
	$(BIN)/python -m roadperc_stream.eval.metrics_page docs/metrics.md docs/scaling.md
	$(BIN)/python -m roadperc_stream.cli.settings > docs/settings.md

sample: $(VENV)/.installed
	$(BIN)/roadperc-render $(SAMPLE_DUMP) $(SAMPLE_OPTIONS) --force
	$(BIN)/roadperc-convert $(SAMPLE_DUMP) logs/sample.mcap --force

docs: $(VENV)/.installed  # build/site with the API reference; a broken link is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

pictures: $(VENV)/.installed $(EVENT_LOGS)  # all pictures of docs/ except foxglove.png and rerun.jpg; needs chromium
	$(BIN)/roadperc-render $(PICTURES)/drive --scene town --size 1280x720 --seconds 2.2 --force
	$(BIN)/roadperc-convert $(PICTURES)/drive $(PICTURES)/town.mcap --force --quiet
	$(BIN)/roadperc-replay $(PICTURES)/town.mcap $(PICTURES)/result.mcap --overlay --force
	$(BIN)/roadperc-report $(PICTURES)/result.metrics.parquet --html $(PICTURES)/report.html
	$(BIN)/python docs/make_pictures.py report $(PICTURES)/result.mcap $(PICTURES)/report.html
	$(BIN)/python docs/make_pictures.py frames $(PICTURES)/change.mcap docs/lane_change.jpg 67 76
	$(BIN)/python docs/make_pictures.py frames $(PICTURES)/brake.mcap docs/braking.jpg 63 78
	$(BIN)/python docs/make_pictures.py frames $(PICTURES)/worn.mcap docs/worn.jpg 38 54
	$(BIN)/python -m tests.degrade_pictures logs/sample.mcap $(PICTURES)
	$(BIN)/roadperc-render $(COURSE)-drive --scene town --size 640x480 --seconds 0.5 --tag-noise 0.02 --depth-noise 0.01 --force
	$(BIN)/roadperc-convert $(COURSE)-drive $(COURSE)-input.mcap --force --quiet
	$(BIN)/roadperc-replay $(COURSE)-input.mcap $(COURSE).mcap --overlay --debug --template 0:380,234,482,292 --force
	$(BIN)/python docs/make_pictures.py frames $(COURSE).mcap docs/course_surface.jpg debug/surface:7
	$(BIN)/python docs/make_pictures.py frames $(COURSE).mcap docs/course_lanes.jpg debug/lanes:7
	$(BIN)/python docs/make_pictures.py frames $(COURSE).mcap docs/course_objects.jpg 0
	$(BIN)/python docs/make_pictures.py frames $(COURSE).mcap docs/course_stereo.jpg debug/disparity:1 debug/template:1
	$(BIN)/python docs/make_pictures.py frames $(COURSE).mcap docs/course_matches.jpg debug/matches:7

$(PICTURES)/change.mcap: EVENT := --scene town --change-lane left --seed 113
$(PICTURES)/brake.mcap: EVENT := --scene town --lead-brakes --seed 101
$(PICTURES)/worn.mcap: EVENT := --scene straight --worn-lines 15,40 --seed 120
$(EVENT_LOGS): $(PICTURES)/%.mcap: $(VENV)/.installed
	$(BIN)/roadperc-render $(PICTURES)/$*-drive $(EVENT) $(EVENT_OPTIONS)
	$(BIN)/roadperc-convert $(PICTURES)/$*-drive $(PICTURES)/$*-input.mcap --force --quiet
	$(BIN)/roadperc-replay $(PICTURES)/$*-input.mcap $@ --overlay --force

clean:
	rm -rf $(VENV) $(DEMO) build dist *.egg-info
	rm -f $(addprefix roadperc_stream/kernels/*.,c so pyd)
