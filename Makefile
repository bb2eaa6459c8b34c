# SPDX-License-Identifier: Apache-2.0
# `make learn` and `make test` set up .venv on first use. They need Python 3.10-3.13.

PYTHON ?= python3
ARGS ?=
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed
READY := $(VENV)/ready

# ROS stays on this machine unless the environment says otherwise.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# The rclpy wheels record in this variable that their libraries are on the path, which is true for this .venv only.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Python keeps what it compiles, whatever a container says: tests start some hundreds of processes.
unexport PYTHONDONTWRITEBYTECODE

# A sourced ROS 2 Jazzy or Kilted provides rclpy, NumPy 1 and Pinocchio, and `make build` builds the interfaces; otherwise
# everything comes from PyPI, and pip builds the interfaces.
ifneq ($(filter jazzy kilted,$(ROS_DISTRO)),)
VENV_FLAGS := --system-site-packages
EXTRAS := view,reproduce,camera,completion,test,browser,dev
CONSTRAIN = echo 'numpy<2' > $(VENV)/constraints.txt
INTERFACES :=
BUILT := . wam_power_interfaces
else
VENV_FLAGS :=
EXTRAS := ros,view,reproduce,camera,completion,test,browser,dev
CONSTRAIN = : > $(VENV)/constraints.txt
INTERFACES := wam_power_interfaces
BUILT := .
endif

.PHONY: help learn reproduce test lint format build site venv clean

help:
	@echo 'make learn [ARGS="--seed 3"]   learn to flip a pancake in simulation'
	@echo 'make reproduce                 run the experiments of the paper and write a report (within an hour on 2 cores)'
	@echo 'make test  [ARGS="-k power"]   run the tests, but for the long ones: ARGS="-m long"'
	@echo 'make lint                      check rules and format (ruff) and types (mypy)'
	@echo 'make format                    apply the automatic fixes and the format of ruff'
	@echo 'make build                     run colcon build; installs colcon from PyPI if it is missing'
	@echo 'make site                      make a site of all pages and docstrings in site/, and check its links'
	@echo 'make venv                      only set up .venv'
	@echo 'make clean                     delete .venv and everything that was built'

venv: $(READY)

$(INSTALLED): requirements.txt setup.py setup.cfg wam_power_ros/_kernel.c
	@$(PYTHON) -c 'import sys; v = sys.version_info; \
	    sys.exit(None if (3, 10) <= v < (3, 14) else "Python 3.10 to 3.13 is needed, this is %d.%d: make PYTHON=python3.12 ..." % v[:2])'
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV_FLAGS) $(VENV)
	@$(CONSTRAIN)
	@echo 'Installing into $(VENV), only once; this takes a minute or two.'
	@$(BIN)/python -m pip install --quiet --upgrade pip  # an old pip takes minutes to resolve the versions
	@PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet --no-compile -c $(VENV)/constraints.txt -e '.[$(EXTRAS)]'  # Python compiles what it imports
	@$(BIN)/python -c 'import mujoco, pinocchio, rclpy' || { \
	    echo 'A system library is missing, see above. For libgomp.so.1: apt install libgomp1'; exit 1; }
	@touch $@

$(READY): $(INSTALLED) $(shell find wam_power_interfaces -type f -not -name '*.pyc')
	$(if $(INTERFACES),$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --force-reinstall ./$(INTERFACES))
	@touch $@

# Ctrl-C is a regular end: the shell waits for the command, and make reports no error.
STOPPABLE = trap : INT; $(1) || [ $$? -eq 130 ]

learn: $(READY)
	@$(call STOPPABLE,$(BIN)/wam-power learn $(ARGS))

reproduce: $(READY)
	@$(call STOPPABLE,$(BIN)/python -m reproduction $(ARGS))

# In the order of test/conftest.py: slow folders first. Four workers on two cores, because many tests wait for a clock.
# Linear algebra uses one thread, as in every node (entry.py). The last -m counts: ARGS="-m long" runs others.
test: export OPENBLAS_NUM_THREADS := 1
test: $(READY)
	$(BIN)/python -m pytest -n 4 --dist loadfile --no-loadscope-reorder -m "not long and not alone" $(ARGS)
	$(if $(ARGS),,$(BIN)/python -m pytest -m alone test/nodes)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# colcon runs with the Python of .venv, because the installed executables start with the Python that built them. It does not
# look for packages inside of a package, so it is given both folders.
build: $(READY)
	@$(BIN)/python -c 'import colcon, colcon_ros' 2>/dev/null || PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet \
	    -c $(VENV)/constraints.txt -e '.[build]'
	$(BIN)/python -m colcon build --base-paths $(BUILT) --packages-up-to wam_power_ros

# The site has a virtual environment of its own: 0.2 GB that nothing else needs.
site:
	@$(VENV)/site/bin/python -c 'import mkdocs, material, mkdocstrings' 2>/dev/null || { $(PYTHON) -m venv $(VENV)/site && \
	    sed -n '/^# \[site\]/,/^$$/p' requirements.txt > $(VENV)/site.txt && $(VENV)/site/bin/python -m pip install --quiet -r $(VENV)/site.txt; }
	NO_MKDOCS_2_WARNING=1 $(VENV)/site/bin/python docs/site.py

clean:
	rm -rf $(VENV) build install log site
