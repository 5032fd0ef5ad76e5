# Two commands are all a newcomer needs: `make annotate` and `make test`. Everything else stands in `make help`.
# Python 3.11 or 3.12 by preference: mediapipe, the default detector, has no wheel with its models for later ones.
PYTHON ?= $(shell for python in python3 python3.12 python3.11; do \
	$$python -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 13))' 2>/dev/null && echo $$python && break; \
	done || echo python3)
SEQ ?=
PRESET ?= tiny
SET ?=
TARGET ?= annotate
ARGS ?=

VENV := .venv
BIN := $(VENV)/bin
RUN := $(BIN)/python -m pipeline
SEQUENCE := $(if $(SET),manifest=data_manifests/synthetic_$(SET).csv) $(if $(SEQ),'seq=$(SEQ)',$(if $(SET),seq=all))
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
# Those that need nothing: no run, no package that is not a dependency, no half hour. docs/benchmarks.md has the others.
BENCHMARKS := triangulation remap decode render crop_mode unprojection msg3d ego_only
SOURCES := assemblyhands_core stages pipeline tests benchmarks notebooks

.PHONY: all annotate evaluate simulate train ego predict train-ego verbs train-verbs export report compare view suspects correct plan doctor gc fsck test test-slow check format benchmark docs help clean
.DEFAULT_GOAL := help

annotate: $(VENV)/.installed  ## video in, 3D hand joints out: SEQ=name (default: records one), ARGS='parameter=value'
	$(RUN) annotate $(SEQUENCE) $(ARGS)

evaluate: $(VENV)/.installed  ## annotate, and hold every round against the simulator's truth: SET=test, SET=desktop, or SEQ=name
	$(RUN) evaluate $(SEQUENCE) $(ARGS)

simulate: $(VENV)/.installed  ## record synthetic sequences: SET=tiny, test, desktop, ego, verbs, small or full, or SEQ=name
	$(RUN) simulate $(SEQUENCE) $(ARGS)

all: $(VENV)/.installed-training  ## everything, from recordings to the tables of the paper and a report: PRESET=tiny, small or paper
	$(RUN) all preset=$(PRESET) $(ARGS)

train: $(VENV)/.installed-training  ## draw crops in the studio and train our networks on them (hours; goes on where it was)
	$(RUN) training_data manifest=data_manifests/training_crops.csv seq=crops_train $(ARGS)
	$(RUN) train manifest=data_manifests/training_crops.csv seq=crops_train executor=serial $(ARGS)

ego: $(VENV)/.installed  ## crops of the headset's pictures, with our labels and people's
	$(RUN) ego $(SEQUENCE) $(ARGS)

predict: $(VENV)/.installed  ## hands in the headset's pictures, by SVEgoNet
	$(RUN) predict $(SEQUENCE) $(ARGS)

train-ego: $(VENV)/.installed-training  ## train SVEgoNet on a set: SET=ego, or ARGS='manifest=… seq=…'
	$(RUN) train_ego $(SEQUENCE) $(ARGS)

verbs: $(VENV)/.installed  ## which verb is being done, from hand poses of each source
	$(RUN) verbs $(SEQUENCE) $(ARGS)

train-verbs: $(VENV)/.installed-training  ## draw poses in the studio, and train MS-G3D on them
	$(RUN) verb_weights manifest=data_manifests/training_poses.csv seq=all executor=local $(ARGS)

export: $(VENV)/.installed  ## annotate, and write AssemblyHands and COCO files of it
	$(RUN) export $(SEQUENCE) $(ARGS)

view: $(VENV)/.installed-view  ## a run in the viewer rerun, cameras, pictures and joints on one time line: SEQ=name, ARGS='run=NAME'
	$(RUN) view $(SEQUENCE) $(ARGS)

report: $(VENV)/.installed  ## write the page of the latest run, or of another one: ARGS='run=NAME'
	$(RUN) report $(ARGS)

compare: $(VENV)/.installed  ## two runs of the same sequences, difference by difference: A=run B=run
	$(RUN) compare $(A) $(B) $(ARGS)

suspects: $(VENV)/.installed  ## what is probably wrong in a run, with pictures, for CVAT or another tool: SEQ=name
	$(RUN) suspects $(SEQUENCE) $(ARGS)

correct: $(VENV)/.installed  ## take over what was corrected in CVAT or another tool: FILE=person_keypoints_default.json
	$(RUN) correct 'corrected=$(FILE)' $(ARGS)

plan: $(VENV)/.installed  ## what a run would do, what it would reuse, and why: TARGET=all, evaluate, … (default: annotate)
	$(RUN) plan $(TARGET) $(if $(filter all,$(TARGET)),preset=$(PRESET)) $(SEQUENCE) $(ARGS)

doctor: $(VENV)/.installed  ## look a recording over before hours are spent on it: SEQ=name
	$(RUN) doctor $(SEQUENCE) $(ARGS)

gc: $(VENV)/.installed  ## remove results that none of the newest runs refers to
	$(RUN) gc $(ARGS)

fsck: $(VENV)/.installed  ## read all results again, set aside what is damaged: the next run makes it anew
	$(RUN) fsck $(ARGS)

test: $(VENV)/.installed-dev  ## the tests (minutes)
	$(BIN)/python -m pytest -m 'not slow' -n auto --maxprocesses 4 --dist loadfile $(ARGS)

test-slow: $(VENV)/.installed-dev  ## the tests that take long, on real footage and under faults
	$(BIN)/python -m pytest -m slow $(ARGS)

check: $(VENV)/.installed-dev  ## format, lint, types, import layers and tests: what CI runs
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(MAKE) test

format: $(VENV)/.installed-dev  ## put the code into the house's format
	$(BIN)/ruff check --fix --quiet $(SOURCES)
	$(BIN)/ruff format $(SOURCES)

benchmark: $(VENV)/.installed-dev  ## speed, side by side with the alternatives
	for name in $(BENCHMARKS); do $(BIN)/python benchmarks/$$name.py || exit 1; done

docs: $(VENV)/.installed  ## print docs/tables.md anew from the pipeline
	$(RUN) describe > docs/.tables.md && mv docs/.tables.md docs/tables.md

help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo
	@echo "  A rig of your own: make annotate SEQ=NAME ARGS=\"rig.calibration=PATH rig.videos='GLOB'\""
	@echo "  All parameters:    $(RUN) --cfg job"

clean:  ## remove the environment; results in work/ stay
	rm -rf $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or later is needed, $(PYTHON) is older: make PYTHON=python3.12 …"; exit 1; }
	@echo "installing into $(VENV) (once, about a minute) …"
	@test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV) || \
		{ $(PYTHON) -m venv --without-pip $(VENV) && $(PYTHON) -m pip --python $(BIN)/python install --quiet pip; }
	$(PIP) --editable .
	@$(BIN)/python -c 'import sys; sys.exit(sys.version_info >= (3, 13))' && $(PIP) --no-deps mediapipe || \
		echo "mediapipe has no wheel for this Python: use detectors rtmlib or precomputed, or Python 3.12"
	@touch $@

$(VENV)/.installed-training: $(VENV)/.installed
	$(PIP) --editable '.[training]'
	@touch $@

$(VENV)/.installed-view: $(VENV)/.installed
	$(PIP) --editable '.[view]'
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(PIP) --editable '.[dev]'
	@touch $@
