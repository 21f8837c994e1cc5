PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Without bytecode each of the hundreds of processes of the tests compiles every module that it imports.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo docs test pytest fuzz peers processors lint mutants wheel clean
$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	# Kernels of recordings and datasets are compiled while torch is installed, which is large.
	$(BIN)/mirror compile --workers 1 & \
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt torch==2.13.0; \
	code=$$?; wait; exit $$code
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	# Those of reconstruction and simulation need what was installed since. Each worker of the tests would compile them.
	$(BIN)/mirror compile
	touch $(STAMP)

# A synthetic street, ingested, split and reported: ends with demo/report.html. DEMO="--quick" for a short one.
demo: $(STAMP)
	$(BIN)/mirror demo --out demo $(DEMO)

# The checks of types occupy one core for a minute: the tests run beside them, and either fails the target.
test: $(STAMP)
	$(MAKE) --no-print-directory -j 2 lint pytest

# Each worker begins with one half of the files, so that few of them are set up in both.
pytest: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist worksteal

# Five hundred damaged recordings of every reader, for which `make test` has ten, and what came of them; then all
# examples of properties, of which `make test` tries a quarter.
fuzz: $(STAMP)
	MIRROR_FUZZ=500 $(BIN)/python -m pytest -n 2 -rP tests/fuzz
	HYPOTHESIS_PROFILE=whole $(BIN)/python -m pytest -n 2 -m hypothesis

# Environments of other toolkits in build/peers; what they read of our files is written to tests/peers.
peers: $(STAMP)
	$(BIN)/python -m tests.peers

# The numerical rooms once more, with the BLAS kernels and the instruction sets of other processors.
processors: $(STAMP)
	$(BIN)/python -m tests.processors

# The wheel, and `mirror demo --quick` from it without the packages of any extra.
wheel: $(STAMP)
	MIRROR_WHEEL_DEMO=1 $(BIN)/python -m pytest -n 0 tests/test_wheel.py

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python docs/check_words.py
	$(BIN)/python docs/make_site.py

# The site of the documentation in build/site; a link to nothing ends it. `make lint` builds it too.
docs: $(STAMP)
	$(BIN)/python docs/make_site.py

clean:
	rm -rf $(VENV) demo build dist *.egg-info

# 300 changes of one token, each run against the tests of its room: up to four hours of one core. Not in CI.
mutants: $(STAMP)
	$(BIN)/python -m benchmarks mutants
