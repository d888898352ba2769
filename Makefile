# `make demo` and `make test` are all that a newcomer needs; both make .venv when it is not there.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Small matrices run faster on one thread, and parallel runs do not fight for the cores.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Where Python keeps no bytecode, as in many containers, every worker compiles all tests anew.
unexport PYTHONDONTWRITEBYTECODE
# MuJoCo draws by EGL where there is no screen.
ifeq ($(shell uname -s)$(DISPLAY),Linux)
export MUJOCO_GL ?= egl
endif

.PHONY: demo test slow core lowest results check style types pyright imports format docs wheel-test wheels arduino release-check linkcheck clean

demo: $(VENV)/.demo
	$(BIN)/surefoot demo $(DEMO)

# What a change needs while it is made, in two minutes of two cores; with what takes 0.2 s or more (tests/long.txt),
# as CI runs it: make test MARKS="not slow".
MARKS ?= not slow and not long
test: $(VENV)/.dev
	$(BIN)/pytest -n auto --dist loadfile -m "$(MARKS)" $(PYTEST)

# What runs on a robot, with what a robot has: NumPy and SciPy; and pytest and hypothesis.
CORE := build/core
core: $(CORE)/.made
	$(CORE)/bin/pytest -n auto --dist loadfile -m "not slow" tests/calibration tests/sensors $(PYTEST)

# The oldest versions that pyproject.toml names. What warns there are old packages, of others newer than they know.
LOWEST := build/lowest
LOWEST_TESTS ?= tests/wrappers tests/experiments
lowest: $(LOWEST)/.made
	$(LOWEST)/bin/pytest -n auto --dist loadfile -m "not slow" -o filterwarnings=default $(LOWEST_TESTS) $(PYTEST)

# All studies, and their tables into docs/data: about an hour on two cores; what is finished is not run again. More
# walks, rigs and episodes make narrower intervals.
RESULTS := out/results
WALKS ?= 10
RIGS ?= 12
EPISODES ?= 8
HARD_EPISODES ?= 32
ROBOTS ?= 3
FEEDS := --severity 1 --severity 2 --feed true --feed raw --feed moment
results: $(VENV)/.dev
	$(BIN)/python benchmarks/walks.py --seeds $(WALKS) --jobs 2
	for task in balance:NaoBalance walk:NaoCarry; do \
		$(BIN)/surefoot evaluate surefoot/$${task#*:}-v0 shipped shipped-randomised stabiliser zero $(FEEDS) \
			--feed weights --feed quasi-static --feed window --seeds $(EPISODES) --jobs 2 \
			--out $(RESULTS)/$${task%:*} || exit 1; \
		$(BIN)/surefoot evaluate surefoot/$${task#*:}Hard-v0 shipped zero $(FEEDS) --seeds $(HARD_EPISODES) --jobs 2 \
			--out $(RESULTS)/$${task%:*}-hard || exit 1; \
	done
	$(BIN)/python benchmarks/in_situ_paper.py --seeds $(RIGS) --jobs 2
	$(BIN)/python benchmarks/robots.py --seeds $(ROBOTS) --jobs 2
	$(BIN)/python benchmarks/cop_paper.py --seeds $(WALKS) --jobs 2
	$(BIN)/python docs/study_tables.py $(RESULTS)

# Studies that take minutes: a million fuzzed samples, consistency over 200 runs.
slow: $(VENV)/.dev
	$(BIN)/pytest -n auto --dist loadfile -m slow $(PYTEST)

# Each by itself, so that `make -j 2 check` uses two cores.
check: style types pyright imports
style: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
types: $(VENV)/.dev
	$(BIN)/mypy
	$(BIN)/mypy benchmarks/*.py
pyright: $(VENV)/.dev
	$(BIN)/pyright
imports: $(VENV)/.dev
	$(BIN)/lint-imports

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The site: tutorials and gallery are executed, links checked, and a warning is an error. A minute and a half of one
# core; without executing, 20 s, as in .ci/run: make docs SPHINX="-D nb_execution_mode=off".
docs: $(VENV)/.dev
	$(BIN)/sphinx-build -q -W --keep-going -E -b html -d build/doctrees $(SPHINX) docs build/docs

# Links to other places, for who has a network.
linkcheck: $(VENV)/.dev
	$(BIN)/sphinx-build -q -E -b linkcheck -D nb_execution_mode=off docs build/links

# The suite once more, against what a user installs: the built wheel, away from the checkout. Doctests import every
# module of it; WHEEL_TESTS may name those tests alone that need files which a wheel could lack.
WHEEL_TESTS ?= tests
wheel-test: $(VENV)/.dev
	rm -rf build/wheel && mkdir -p build/wheel
	$(BIN)/python -m build --outdir build/wheel .
	$(BIN)/pip install --quiet --no-deps --target build/wheel/site build/wheel/*.whl
	cp -r tests pyproject.toml build/wheel/
	cd build/wheel && PYTHONPATH=site SUREFOOT_EXPECT_ROOT=$$PWD/site \
		../../$(BIN)/pytest -n auto --dist loadfile -m "not slow" $(WHEEL_TESTS) site/surefoot $(PYTEST)

# The sdist and the wheels of all platforms, on any of them: ziglang (100 MB) compiles the libraries.
ZIG := build/zig
wheels: $(VENV)/.dev
	test -d $(ZIG) || $(BIN)/pip install --quiet --no-deps --target $(ZIG) 'ziglang>=0.14' 'setuptools>=77'
	rm -rf dist && $(BIN)/python -m build --sdist --outdir dist .
	for platform in $$($(BIN)/python -c 'from surefoot.native.build import PLATFORMS; print(*PLATFORMS)'); do \
		rm -rf build/lib build/bdist.*; \
		SUREFOOT_PLATFORM=$$platform PYTHONPATH=$(CURDIR)/$(ZIG) $(BIN)/python -m build --wheel --no-isolation --outdir dist . || exit 1; \
	done

# A library for Arduino as its editor takes it, with the headers in the place of links.
arduino:
	rm -rf build/Surefoot && mkdir -p build && cp -rL arduino build/Surefoot
	cd build && python3 -m zipfile -c surefoot-arduino.zip Surefoot

# Before a release: twine reads what `make wheels` made, each extra (or EXTRAS) is installed alone and used, and the two
# commands of README run in the sdist. Half an hour or more, gigabytes; needs an index of packages.
release-check: wheels
	test -d build/twine || $(BIN)/pip install --quiet --target build/twine twine
	PYTHONPATH=build/twine $(BIN)/python -m twine check --strict dist/*
	nice $(BIN)/python tests/packaging/release.py dist $(EXTRAS)
	rm -rf build/sdist && mkdir build/sdist && tar xzf dist/*.tar.gz --strip-components 1 -C build/sdist
	nice $(MAKE) -C build/sdist demo test MARKS="not slow"
	rm -rf build/sdist
	! grep -n OWNER pyproject.toml  # the repository's address is to be set

%/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "surefoot needs Python 3.11 or newer; name one with: make PYTHON=python3.12 ..." >&2; exit 1; }
	$(PYTHON) -m venv $*

# pip installs, by the user's configuration, and compiles no bytecode: Python does so for what is used. INSTALLER=uv takes a seventh of its time, but leaves torch to pip, whose
# configuration says which build of it.
UV := build/uv/bin/uv
$(UV): | build/uv/bin/python
	build/uv/bin/pip install --quiet uv
torch_by_pip = $(1)/bin/pip install --quiet --no-compile -c constraints.txt torch
ifeq ($(INSTALLER),uv)
install = $(UV) pip install --quiet --python $(1)/bin/python
before_install = $(torch_by_pip)
NEEDS_UV := $(UV)
else
install = $(1)/bin/pip install --quiet --no-compile
endif

# An install with [dev] serves the demo as well.
NATIVE := setup.py native/build.py $(wildcard native/*.[ch])
SOURCES := pyproject.toml constraints.txt $(NATIVE)
$(VENV)/.demo: $(SOURCES) | $(BIN)/python $(NEEDS_UV)
	test -e $(VENV)/.dev || $(call install,$(VENV)) -c constraints.txt -e '.[experiments]'
	touch $@

$(VENV)/.dev: $(SOURCES) | $(BIN)/python $(NEEDS_UV)
	$(call before_install,$(VENV))
	$(call install,$(VENV)) -c constraints.txt -e '.[dev]'
	touch $@ $(VENV)/.demo

$(CORE)/.made: $(SOURCES) | $(CORE)/bin/python $(NEEDS_UV)
	$(call install,$(CORE)) -c constraints.txt -e '.[test]'
	touch $@

$(LOWEST)/.made: $(SOURCES) | $(LOWEST)/bin/python $(UV)
	$(call torch_by_pip,$(LOWEST))
	$(UV) pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct \
		-e '.[rl,robots,experiments,ros,view,test]'
	touch $@

clean:
	rm -rf build dist out .pytest_cache .mypy_cache .ruff_cache .hypothesis *.egg-info
