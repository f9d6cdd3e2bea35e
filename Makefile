# The two commands of the README are `make demo` and `make test`; `make help` lists all.
# Whatever they need beyond Rust, Python >= 3.10 and a C compiler goes into .venv and target/.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
# The extension module is left to the interpreter to link.
export PYO3_BUILD_EXTENSION_MODULE := 1
export CARGO_TERM_COLOR ?= auto

# $(call suite,name,command): runs a suite and prints how long it took.
define suite
@printf '\n==> %s\n' "$(1)"; start=$$(date +%s); ( $(2) ) || { echo "FAILED: $(1)"; exit 1; }; \
printf -- '--- %s: %s s\n' "$(1)" "$$(( $$(date +%s) - start ))"
endef

.PHONY: help demo test test-rust test-python test-packaging test-long lint bench doc build clean
help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 18

demo: build  ## calibrate the Furuta pendulum against measurements, draw furuta.png
	$(BIN)/python examples/furuta.py

test: lint test-rust test-python test-packaging  ## everything that must pass before a commit
	@echo; echo "all suites passed"

lint: $(VENV)/.tools  ## formatting, clippy, docs with warnings denied, the gate
	$(call suite,format,cargo fmt --all --check)
	$(call suite,gate,$(BIN)/python tools/gate.py)
	$(call suite,clippy,cargo clippy --workspace --all-targets --quiet -- -D warnings)
	$(call suite,rustdoc,RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --quiet)

test-rust:  ## unit tests, black-box tests, doctests, examples
	$(call suite,cargo test,cargo test --workspace --quiet)
	$(call suite,rust examples,for e in $(basename $(notdir $(wildcard examples/*.rs))); do \
		cargo run --quiet --example $$e >/dev/null || exit 1; done)

test-python: build  ## pytest, stub check, examples
	$(call suite,pytest,$(BIN)/python -m pytest -q crates/pydfo/tests)
	$(call suite,stubs,$(BIN)/python -m mypy.stubtest pydfo && $(BIN)/python -m mypy --strict crates/pydfo/python/pydfo)
	$(call suite,python examples,for e in $(wildcard examples/*.py); do MPLBACKEND=Agg $(BIN)/python $$e >/dev/null || exit 1; done)

test-packaging: $(VENV)/.tools  ## the source distribution builds and works in an empty environment elsewhere
	$(call suite,packaging,bash tools/packaging.sh $(BIN))

test-long: build  ## what takes long: many runs, memory
	$(call suite,long rust tests,cargo test --workspace --release --quiet -- --ignored)
	$(call suite,long python tests,$(BIN)/python -m pytest -q -m long crates/pydfo/tests)

bench: build benches/env/.venv/.done  ## side by side with the peers, in one run
	benches/env/.venv/bin/python benches/against_fmpy.py
	benches/env/.venv/bin/python benches/against_optimisers.py
	cargo bench --workspace

doc:  ## the Rust documentation, in target/doc
	cargo doc --workspace --no-deps

build: $(VENV)/.tools  ## the Python module, installed into .venv
	@$(BIN)/maturin develop --release --quiet --manifest-path crates/pydfo/Cargo.toml

$(VENV)/.tools: crates/pydfo/requirements-dev.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(0 if v >= (3, 10) else f"Python 3.10 or newer is needed, this is {v[0]}.{v[1]}")'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -r $<
	@touch $@

benches/env/.venv/.done: benches/env/requirements.txt $(VENV)/.tools
	@test -x benches/env/.venv/bin/python || $(PYTHON) -m venv benches/env/.venv
	@benches/env/.venv/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	@$(BIN)/maturin build --release --quiet --manifest-path crates/pydfo/Cargo.toml --out target/wheels
	@benches/env/.venv/bin/python -m pip install --quiet --disable-pip-version-check --force-reinstall --no-deps target/wheels/*.whl
	@touch $@

clean:  ## remove what was built and fetched
	rm -rf target $(VENV) benches/env/.venv out
