# Main targets: make demo and make test. Each first sets up its environment.
# make test is what every change must pass; it leaves out the tests marked `exhaustive`.
ROBOT ?= diamond
PYTEST_ARGUMENTS ?=

# A sourced ROS 2 is used with its own environments; otherwise ROS 2 is installed from PyPI.
ifeq ($(and $(ROS_DISTRO),$(AMENT_PREFIX_PATH)),)
VENV := .venv
ROS := --requirement requirements/ros-wheels.txt
else
VENV := .venv-ros
ROS := --constraint requirements/ros-sourced.txt
endif
OLDEST := $(VENV)-oldest
SET_UP := tools/set_up.sh $(VENV) $(ROS)
SET_UP_OLDEST := tools/set_up.sh $(OLDEST) $(ROS) --constraint requirements/oldest.txt

# If another environment's Python has set this variable, ours would not find its ROS libraries.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
# A sourced ROS contains pytest plugins that do not load here.
PYTEST := PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 $(VENV)/bin/python -m pytest \
	-p pytest_timeout --timeout 300
PYTEST_OLDEST := $(subst $(VENV)/,$(OLDEST)/,$(PYTEST))
# The demo and a live viewer are timed, and the fit of a running twin has only what other processes leave
# of the processor, so their tests do not run beside two others.
AGAINST_THE_CLOCK := test/ros/test_calibration.py test/ros/test_demo.py test/view/test_live_viewer.py
FEW := test/test_library_names.py test/kernels/test_compilation.py \
	test/scripting/test_robot.py::test_after_reset_the_same_steps_follow_to_the_bit
# Each process begins with a third of the tests, in order, and takes some of the others' when it is done.
# There is one more than cores: the tests over ROS wait for two thirds of their time.
SHARED := -p xdist -n 3 --dist worksteal $(addprefix --ignore ,$(AGAINST_THE_CLOCK))

.DEFAULT_GOAL := help
# Also with make -j: both test runs start ROS nodes and use all cores.
.NOTPARALLEL:
.PHONY: help setup setup-oldest setup-both demo bench pictures docs types kernels checks test test-all test-rest test-oldest build dist clean

help: ## list the targets
	@echo 'make [ROBOT=$(ROBOT)] TARGET'
	@sed -n 's/^\([a-z-]*\):.*## /    \1\t/p' Makefile | expand -t 20

setup: ## make the environment (.venv; .venv-ros beside a sourced ROS 2)
	@$(SET_UP)

setup-oldest: ## make the environment with the oldest versions supported
	@$(SET_UP_OLDEST)

# One after the other, they would take almost twice as long on two cores.
setup-both:
	@$(SET_UP) & newest=$$!; $(SET_UP_OLDEST); oldest=$$?; wait $$newest && exit $$oldest

demo: setup ## drive a simulated robot through the twin, live; writes out/demo
	$(VENV)/bin/python -m softrobot_twin demo --robot $(ROBOT) --output out/demo

bench: setup ## time every stage of a step over sizes; writes out/bench
	$(VENV)/bin/python tools/bench_robots.py --output out/bench

pictures: setup ## draw the pictures of the robots in docs/ anew
	$(VENV)/bin/python tools/draw_robots.py

docs: setup ## build the documentation as a site; writes out/site
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --strict --site-dir out/site

types: setup ## check the types of the Python interface
	$(VENV)/bin/python -m mypy

kernels: setup ## compile the kernels of all scenes and of usual combinations, on two cores
	$(VENV)/bin/python tools/compile_kernels.py

# One core would wait while types are checked alone.
checks:
	@$(VENV)/bin/python -m mypy & types=$$!; $(VENV)/bin/python tools/compile_kernels.py && wait $$types

# Of the oldest versions: all that the package names exists and takes its arguments, kernels are
# compiled, and a robot steps. What else depends on them needs kernels compiled by the oldest numba.
test: setup-both checks ## run the tests that every change must pass: about 6 minutes, 8 from a clean clone
	$(PYTEST) $(SHARED) -m "not exhaustive" $(PYTEST_ARGUMENTS)
	@$(PYTEST) $(AGAINST_THE_CLOCK) -m "not exhaustive" $(PYTEST_ARGUMENTS) & clock=$$!; \
	$(PYTEST_OLDEST) $(FEW) -m "not exhaustive" $(PYTEST_ARGUMENTS); few=$$?; wait $$clock && exit $$few

test-all: test test-rest ## run all tests

test-rest: setup-both test-oldest ## run the tests that make test leaves out: long ones, more seeds, the oldest versions
	$(PYTEST) $(SHARED) -m exhaustive $(PYTEST_ARGUMENTS)
	$(PYTEST) $(AGAINST_THE_CLOCK) -m exhaustive $(PYTEST_ARGUMENTS)

# What no version of a library changes is tested once: only the tests marked `libraries` are run.
test-oldest: setup-oldest ## run the tests of what libraries do on the oldest versions
	$(PYTEST_OLDEST) $(SHARED) -m "libraries and not exhaustive" $(PYTEST_ARGUMENTS)

build: setup ## build the ROS 2 package into install/ with colcon
	$(VENV)/bin/python -m colcon build

# The wheel is made from the source archive: what the archive lacks, the wheel cannot have.
dist: setup ## build the archives of a release into dist/, with compiled kernels: sources, and a wheel
	$(VENV)/bin/python tools/compile_kernels.py --ship
	$(VENV)/bin/python -m build --no-isolation --outdir dist

clean: ## remove environments and build results; out/ stays
	rm -rf .venv .venv-* build dist install log *.egg-info .pytest_cache
	find softrobot_twin test -name __pycache__ -prune -exec rm -rf {} +
