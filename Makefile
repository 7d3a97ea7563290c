# Two commands do all the set-up on a machine with Python >= 3.11 and make: `make demo` and `make test`.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
# tests start simgap in processes of their own, which otherwise compile its source each time
unexport PYTHONDONTWRITEBYTECODE
LOWEST_TESTS := pytest hypothesis pandas pytest-xdist hatchling httpx httpx2

.PHONY: demo test coverage notebooks proof lint style types docs lowest audit wheel clean
demo: $(STAMP)
	$(BIN)/simgap demo --out out/demo

# types are checked by `make lint`, which CI runs as well
test: $(STAMP) style
	$(BIN)/python -m pytest -n auto --dist worksteal

# the tests of `make test`, slower, with the lines of mjsim, ident and diagnose that none of them runs
coverage: $(STAMP) lint
	$(BIN)/python -m pytest -n auto --dist worksteal --cov

# the notebooks of the documentation, cell after cell
notebooks: $(STAMP)
	$(BIN)/python -m pytest -m slow tests/test_site.py -k a_notebook_runs

proof: $(STAMP)
	$(BIN)/python -m pytest -m slow -n auto --dist worksteal --ignore tests/benchmark/test_quick_grade.py
	$(BIN)/python -m pytest -m slow tests/benchmark/test_quick_grade.py
	$(BIN)/python -m lab.panel kernels --quick

docs: $(STAMP)
	$(BIN)/python -m mkdocs build --strict

# the lowest versions that pyproject.toml declares, in an environment of their own
lowest:
	$(PYTHON) -m venv --clear $(VENV)-lowest
	$(PYTHON) .ci/lowest.py > $(VENV)-lowest/constraints.txt
	$(VENV)-lowest/bin/python -m pip install --quiet -e '.[formats,fleet,app]' $(LOWEST_TESTS) -c $(VENV)-lowest/constraints.txt
	$(VENV)-lowest/bin/python -m pytest -n auto -W ignore::DeprecationWarning tests/test_api.py tests/readers tests/ident \
	  tests/mjsim/test_mjcf.py tests/test_cli.py tests/test_gate.py tests/fleet tests/app

# known vulnerabilities of what is installed; says so and passes where the service cannot be reached
audit: $(STAMP)
	$(BIN)/python -m pip install --quiet 'pip-audit>=2.7' || true
	$(BIN)/python .ci/audit.py

# the wheel, built twice: the same bytes
wheel: export SOURCE_DATE_EPOCH ?= 315532800
wheel: $(STAMP)
	rm -rf dist out/wheel
	$(BIN)/python -m hatchling build -t wheel -d dist
	$(BIN)/python -m hatchling build -t wheel -d out/wheel
	cmp dist/*.whl out/wheel/*.whl

lint: style types

style: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	$(BIN)/mypy

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "simgap needs Python >= 3.11; set PYTHON=..."; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -e '.[dev]'
	@touch $@

clean:
	rm -rf $(VENV) out build dist
