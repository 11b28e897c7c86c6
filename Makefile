# The commands of daily work. On Windows, use git-bash and the commands themselves (CONTRIBUTING.md).
.PHONY: help install check test lint docs bench smoke

PYTHON ?= .venv/bin/python

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## /{printf "make %-8s %s\n", $$1, $$2}' Makefile

install: ## create .venv with the package and everything that the tests need
	python3 -m venv --upgrade-deps .venv
	.venv/bin/python -m pip install -q -c requirements.lock -e ".[test]" -e ./research -e "./packages/smooth_hand_datasets[objects]" -e ./packages/smooth_operator_benchmark -e ./packages/smooth_operator_study -e "./packages/smooth_operator_devices[test]"

check: ## what CI runs: install, tests, lint, types
	bash .ci/run

test: ## the tests alone, in the existing .venv
	$(PYTHON) -m pytest -n 3 --dist loadfile

lint: ## lint, format and types alone
	$(PYTHON) -m ruff check
	$(PYTHON) -m ruff format --check
	$(PYTHON) -m mypy

docs: ## build the documentation site into build/site, and fail on a warning
	$(PYTHON) -m mkdocs build --strict

bench: ## latency per frame of the presets on a built-in recording, under build/
	mkdir -p build
	$(PYTHON) -m smooth_operator sample build/sample.npz --duration 10
	$(PYTHON) -m smooth_operator bench build/sample.npz --methods sbr,sbr:paper,smooth --output build/bench

smoke: ## build sdist and wheel, and use each in an empty environment
	bash .ci/smoke
