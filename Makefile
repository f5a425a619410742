# One command each; `make setup` needs only Python 3.11+ and a package registry.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: setup demo test test-install serve lint bench bench-quality blind blind-score clean

setup: $(STAMP)
	$(BIN)/python -m pvg.models
	$(BIN)/python -m pvg.warmup
	$(BIN)/python -m scripts.samples

# constraints.txt pins every dependency, so that a fresh machine gets what was tested
$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "Python 3.11 or newer is needed"'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt setuptools wheel
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

demo: setup
	$(BIN)/python -m scripts.demo

test: setup
	$(BIN)/python -m pytest

# built, installed into empty environments outside the repository, and used there; needs the package registry
test-install: setup
	$(BIN)/python -m pytest tests/install

serve: setup
	$(BIN)/pvg-service serve

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# the plots' library and the peers to compare with are installed for these two only; ARGS='--quick' for a short run
bench: setup $(VENV)/.bench-installed
	$(BIN)/python -m benchmarks $(ARGS)

bench-quality: setup $(VENV)/.bench-installed
	$(BIN)/python -m benchmarks.quality $(ARGS)

# sheets for eyes that do not know which side is whose: ARGS='--against paper --pairs 40 --out DIR'
blind: setup $(VENV)/.bench-installed
	$(BIN)/python -m benchmarks.blind $(ARGS)

# ARGS='DIR/key/key.json choices.csv [more.csv ...]'
blind-score: $(STAMP)
	$(BIN)/python -m benchmarks.blind.score $(ARGS)

$(VENV)/.bench-installed: pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[bench]'
	touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
