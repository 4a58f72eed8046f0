# Each target sets up all it needs on a bare machine with Python 3.11 and apt; safe to run twice.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
STAMP := .venv/.made-from-constraints

.PHONY: demo test bench bench-compare lint docs gpu-check attack

demo: $(STAMP)
	.venv/bin/rpl build datasets/demo.yaml --workspace workspaces/demo

# Two processes on two cores: more threads would only wait for one another. Each takes whole files, in their order,
# so that none makes what the tests of a file share a second time. Bytecode is kept, so that not every process
# compiles everything anew.
test: $(STAMP)
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 .venv/bin/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder tests

# All benchmarks, one after the other, then `make attack`; the figures are printed once more at the end and kept with
# machine, versions and commit in runs/bench/, a file per run. SHARE is the share of their repetitions that those
# take that have many: with a fifth 27 minutes on two idle cores, without the attack. BENCH names some.
SHARE ?= 0.2
BENCH ?=
bench: demo
	RPL_BENCH_SHARE=$(SHARE) .venv/bin/python tests/bench/whole.py \
		runs/bench/$(shell date -u +%Y-%m-%dT%H-%M-%S).json $(BENCH)
	$(if $(BENCH),,$(MAKE) attack)

# What became slower or faster between two runs: make bench-compare A=runs/bench/one.json B=runs/bench/other.json
bench-compare: $(STAMP)
	@test -f "$(A)" -a -f "$(B)" || { echo "usage: make bench-compare A=runs/bench/one.json B=..." >&2; exit 1; }
	@.venv/bin/python tests/bench/rows.py compare $(A) $(B)

# The paper's presets on this machine's GPU, in less than eight minutes.
gpu-check: demo
	.venv/bin/python -m training.gpu_check

# Damages files, feeds every parser damaged input, sends odd requests, kills builds, servers and trainings: a table
# by kind, in some tens of minutes on two idle cores.
attack: $(STAMP)
	PYTHONPATH=.:tests .venv/bin/python -m attack

# The documentation site, in site/: open site/index.html. A broken link or an undocumented name is an error.
docs: $(STAMP)
	NO_MKDOCS_2_WARNING=1 PYTHONPATH=. .venv/bin/mkdocs build --strict

lint: $(STAMP)
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy --strict rpl_data training

# Made again when the packages change. A .venv that was cut off has no stamp, so it is completed.
$(STAMP): constraints.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed, $(PYTHON) is older: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@sh .ci/system-packages $(PYTHON)
	test -x .venv/bin/pip || $(PYTHON) -m venv .venv
	@echo "Installing the packages into .venv: 7 GB, without a word for some minutes."
	@sh .ci/disk-space 9
	.venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[training,dev]'
	@touch $@
