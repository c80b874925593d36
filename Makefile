# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
# VENV and PYTHON may be given: make test VENV=.venv-312 PYTHON=python3.12
export VENV PYTHON
IN_VENV = @tools/in_venv.sh

.PHONY: help run test soak bench docs lint clean
.NOTPARALLEL:

help:  ## list the targets
	@sed -n 's/^\([a-z]*\): *## /make \1\t/p' Makefile | expand -t 13

run:  ## install what is missing into .venv and fly the square: make run ARGS='--duration 20'
	$(IN_VENV) ros quad_mpc compile
	$(IN_VENV) ros quad_mpc fly $(ARGS)

test:  ## run the tests in the same way: make test ARGS='-k so3'; the slow ones: ARGS='-m slow -n 0'
	$(IN_VENV) ros,test quad_mpc compile
	$(IN_VENV) ros,test python -P -m pytest -n 2 --dist loadfile $(ARGS)

soak: export SOAK_DURATION ?= 1800
soak:  ## fly over DDS for half an hour with lost odometries: make soak SOAK_DURATION=600
	$(IN_VENV) ros,test python -P -m pytest -n 0 -s test/ros/nodes/test_endurance.py $(ARGS)

bench:  ## measure next to acados and cvxpy, renew docs/measurements/performance.md: make bench ARGS='--repeats 5'
	$(IN_VENV) bench python bench/performance.py --publish $(ARGS)

docs:  ## make the documentation, pages and API, in build/docs
	$(IN_VENV) docs sphinx-build -q -W --keep-going -j auto -c docs -d build/doctrees . build/docs
	@echo "The documentation is in build/docs/index.html"

lint:  ## check style, types and layers
	$(IN_VENV) dev ruff check
	$(IN_VENV) dev ruff format --check
	$(IN_VENV) dev mypy
	$(IN_VENV) dev lint-imports
	$(IN_VENV) dev shellcheck tools/*.sh .ci/run
	$(IN_VENV) dev hadolint Dockerfile

clean:  ## remove everything that was built; recorded runs stay
	rm -rf .venv build install log dist *.egg-info .*_cache .hypothesis
