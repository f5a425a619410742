# One command each; `make setup` needs only Python 3.11+ and a package registry.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

# the tests start hundreds of processes, each of which would compile all modules anew
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup demo test test-scaled test-faults test-install fuzz soak audit lock serve lint bench bench-quality blind \
  blind-score grades grades-score clean

setup: $(STAMP)
	$(BIN)/python -m pvg.models
	$(BIN)/python -m pvg.warmup
	$(BIN)/python -m scripts.samples

# constraints.txt pins every dependency, so that a fresh machine gets what was tested; with LOCKED=1, each file
# must have the hash that requirements/all.txt names, which wheels built by oneself do not have
$(STAMP): pyproject.toml client/pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "Python 3.11 or newer is needed"'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
ifeq ($(LOCKED),1)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/all.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e . -e client
else
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt setuptools wheel
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]' -e client
endif
	touch $@

demo: setup
	$(BIN)/python -m scripts.demo

test: setup
	$(BIN)/python -m pytest -n 4 --dist loadgroup --no-loadscope-reorder

# the tests that start an API, on PostgreSQL, Redis and S3 instead of SQLite, files and a folder
test-scaled: setup
	$(BIN)/python -m pytest -n 2 --dist load --scaled tests/service tests/contract

# every drill of a fault, long ones too, and a table of what each promise of the service measured
test-faults: setup
	$(BIN)/python -m pytest -m 'fault or slow' --promises tests

# ARGS='--minutes 10'; the cases that were not answered well are kept in finds/
fuzz: setup
	$(BIN)/python -m tests.fuzz $(ARGS)
	$(BIN)/python -m tests.contract.fuzzing $(ARGS)

# ARGS='--minutes 3' for a short one
soak: setup
	$(BIN)/python -m benchmarks.soak $(ARGS)

# built, installed into empty environments outside the repository, and used there; needs the package registry
test-install: setup
	$(BIN)/python -m pytest -n 2 --dist loadfile tests/install

# whether a weakness is known of any locked dependency; exit status 2 when nobody can be asked
audit: $(STAMP)
	$(BIN)/python -m scripts.audit

# hashes of every file of every pinned version, for all platforms; after a change of constraints.txt. Needs uv.
# api.txt is for a machine or an image that has the API alone: the extras of the service without the library's own
LOCKING := uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --quiet \
  -c constraints.txt requirements/build.in
lock:
	$(LOCKING) pyproject.toml --extra service --extra postgres -o requirements/service.txt
	$(LOCKING) pyproject.toml --extra dev --extra bench -o requirements/all.txt
	$(PYTHON) -c 'import tomllib; extras = tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]; \
	  print(*extras["service"], *extras["postgres"], sep="\n")' | $(LOCKING) - -o requirements/api.txt

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

# sheets of looks with far references, some of them untouched frames, to be graded one by one
grades: setup $(VENV)/.bench-installed
	$(BIN)/python -m benchmarks.grades $(ARGS)

# ARGS='DIR/key/key.json verdicts.csv [more.csv ...]'
grades-score: $(STAMP)
	$(BIN)/python -m benchmarks.grades.score $(ARGS)

$(VENV)/.bench-installed: pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[bench]'
	touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info client/build client/src/*.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
