# make run     the whole pipeline at the size of a small computer (arguments: make run ARGS="+experiment=smoke")
# make test    the tests          make lint, make types    ruff, pyright
# make bench   what is measured, at what rate, on this machine
# Each creates the environment in .venv first, and again when pyproject.toml or constraints.txt change.

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
ARGS ?=

.PHONY: run test lint types bench constraints clean

run: $(STAMP)
	$(BIN)/qjrl $(ARGS)

test: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --max-worker-restart 0 $(ARGS)

lint: $(STAMP)
	$(BIN)/ruff check
	$(BIN)/ruff format --check

types: $(STAMP)
	$(BIN)/pyright --pythonpath $(BIN)/python

# The first python >= 3.12 of: what pyenv or the path call python, versioned names, versions pyenv has but does not show.
$(STAMP): pyproject.toml constraints.txt
	@for candidate in python3 python python3.12 python3.13 python3.14 \
	    "$${PYENV_ROOT:-$$HOME/.pyenv}"/versions/3.1[2-9]*/bin/python; do \
	  if "$$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null; then python="$$candidate"; break; fi; \
	done; \
	if [ -z "$$python" ]; then echo "qjrl needs python 3.12 or newer, and none was found: install one (for example: pyenv install 3.12)" >&2; exit 1; fi; \
	echo "creating $(VENV) with $$("$$python" --version) ($$python)"; \
	rm -rf $(VENV) && "$$python" -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $@

bench: $(STAMP)
	@for script in experiments/bench/*.py; do echo "== $$script"; $(BIN)/python "$$script" || exit 1; done

constraints: $(STAMP)
	$(BIN)/python -m pip install --quiet uv
	printf '# The versions that are tested. Renewed by: make constraints\n' > constraints.txt.new
	$(BIN)/uv pip compile --quiet --universal --python-version 3.12 --no-emit-index-url --no-annotate --no-header \
	  --extra bench --extra cluster --extra dev pyproject.toml >> constraints.txt.new
	mv constraints.txt.new constraints.txt

clean:
	rm -rf $(VENV) build dist outputs .pytest_cache .ruff_cache .hypothesis
	find qjrl tests -name __pycache__ -type d -prune -exec rm -rf {} +
