# make demo | test | lint | schema | docs | bench | screenshots | clean; `make help` explains.
# Where rclpy is importable (ROS sourced), .venv sees it; elsewhere .venv gets the PyPI wheels.

PYTHON ?= python3
VENV ?= .venv
RUN = $(VENV)/bin/python

# A venv belongs to the ROS it was made for: sourcing another one makes it anew.
READY = $(VENV)/ready-$(or $(ROS_DISTRO),wheels)
REQUIREMENTS = requirements.txt requirements-dev.txt requirements-cluster.txt requirements-page.txt \
  requirements-plan.txt requirements-plot.txt requirements-record.txt requirements-fast.txt
ROS_WHEELS = requirements-ros-wheels.txt
INSTALL = $(RUN) -m pip install --quiet --disable-pip-version-check

# Traffic stays on this machine, and runs beside each other do not hear each other.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
ifndef ROS_DOMAIN_ID
export ROS_DOMAIN_ID := $(shell echo $$(( $$$$ % 100 + 1 )))
endif

# The wheels set these for their own venv only; another venv's would lead this one astray.
ifdef _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
endif

.PHONY: help demo test lint schema docs bench screenshots clean

help:
	@echo 'make demo    fly a mission in simulation, on one terminal'
	@echo 'make test    run the tests (ARGS="-k name" for some)'
	@echo 'make lint    ruff (rules and format) and mypy'
	@echo 'make schema  write config/mission.schema.json anew'
	@echo 'make docs    build the documentation site, build/docs/html/index.html'
	@echo 'make bench   run the benchmarks and show what differs from docs/ (UPDATE=1 writes it there)'
	@echo '             (SCRIPTS=benchmarks/solve.py for some, ARGS="--goals 8" for its options)'
	@echo 'make screenshots  take the pictures of the page in docs/ anew, from a demo'
	@echo 'make clean   remove $(VENV), build results and caches'
	@echo 'PYTHON=python3.12 VENV=.venv312 choose another interpreter and its own venv'

demo: $(READY)
	$(RUN) -m uav_mission_manager.cli.demo $(ARGS)

# With ARGS such as "-k name" one of the two may have nothing to run, which pytest says with exit code 5.
NONE_CHOSEN = $(if $(ARGS),|| test $$? -eq 5)

# Unit tests share the processors: a process that has none left takes half of another's, so that
# none ends long before the others. Integration tests mostly wait, so six at a time, after them.
test: $(READY)
	@$(if $(ARGS),:,echo 'About twelve minutes on two processors: half for the unit tests, half for the integration tests')
	$(RUN) -m pytest test/unit test/property -n auto --dist worksteal $(ARGS) $(NONE_CHOSEN)
	$(RUN) -m pytest test/integration -n 6 --maxschedchunk 1 $(ARGS) $(NONE_CHOSEN)

lint: $(READY)
	$(RUN) -m ruff check
	$(RUN) -m ruff format --check
	$(RUN) -m mypy

schema: $(READY)
	$(RUN) -m uav_mission_manager.mdp.mission_schema > config/mission.schema.json

# A warning is an error. Every page is made anew, for no warning to be missed.
docs: $(READY)
	@$(INSTALL) -r requirements-docs.txt
	$(RUN) -m sphinx -EW --keep-going -q docs build/docs/html $(ARGS)
	@echo 'build/docs/html/index.html'

# Pages go to build/bench/; with UPDATE=1 they replace those in docs/. ARGS are one script's.
SCRIPTS ?= $(wildcard benchmarks/*.py)
bench: $(READY)
	@$(INSTALL) -r requirements-bench.txt
	@set -e; for script in $(SCRIPTS); do \
	  echo "$$script"; PYTHONPATH="$(CURDIR)$${PYTHONPATH:+:$$PYTHONPATH}" \
	    $(RUN) "$$script" $(ARGS) $(if $(UPDATE),--update); \
	done

$(READY): $(REQUIREMENTS) $(ROS_WHEELS)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	  { echo '$(PYTHON) is missing or older than 3.10: choose another with PYTHON=...' >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' || \
	  { echo '$(PYTHON) cannot make a venv: sudo apt install python3-venv' >&2; exit 1; }
	@echo 'Setting up $(VENV): a minute or two, once'
	@if $(PYTHON) -c 'import rclpy' 2>/dev/null; then site=--system-site-packages; fi; \
	  $(PYTHON) -m venv --clear $$site $(VENV)
	@$(INSTALL) $(REQUIREMENTS:%=-r %)
	@$(RUN) -c 'import rclpy' 2>/dev/null || $(INSTALL) -r $(ROS_WHEELS)
	@touch $@

# The pictures of the console in docs/; needs Chromium.
screenshots: $(READY)
	$(RUN) docs/screenshots.py

clean:
	rm -rf $(VENV) build docs/reference install log dist *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
