# The two commands of the README are `make demo` and `make test`; `make help` lists all.
# Whatever they need beyond Rust, Python >= 3.10 and a C compiler goes into .venv and target/.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
SITE   := target/site-venv
ENGINES := target/engines-venv
WINDOWS := x86_64-pc-windows-gnu
MINGW := CARGO_TARGET_X86_64_PC_WINDOWS_GNU_LINKER=x86_64-w64-mingw32-gcc
WINDOWS_32 := i686-pc-windows-gnu
MINGW_32 := CARGO_TARGET_I686_PC_WINDOWS_GNU_LINKER=i686-w64-mingw32-gcc
WORKER_FOLDER ?= $(or $(XDG_DATA_HOME),$(HOME)/.local/share)/fmufit
WINE ?= $(or $(shell command -v wine64),/usr/lib/wine/wine64)
# The extension module is left to the interpreter to link.
export PYO3_BUILD_EXTENSION_MODULE := 1
export CARGO_TERM_COLOR ?= auto

# $(call suite,name,command): runs a suite and prints how long it took.
define suite
@printf '\n==> %s\n' "$(1)"; start=$$(date +%s); ( $(2) ) || { echo "FAILED: $(1)"; exit 1; }; \
printf -- '--- %s: %s s\n' "$(1)" "$$(( $$(date +%s) - start ))"
endef

# $(call develop,options): builds the Python module and installs it into .venv.
develop = @$(BIN)/maturin develop --quiet --manifest-path crates/pydfo/Cargo.toml $(1)

.PHONY: help demo test test-rust test-python test-packaging test-engines test-windows windows-crates wine-crates wine-fits wine-models windows-worker windows-worker-32 windows-python test-long lint lint-windows bench bench-dfo doc pictures build fuzz sanitize nightly clean
help:  ## this list
	@grep -hE '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z0-9-]+):.*## /\1\t/' | expand -t 18

demo: $(VENV)/.demo  ## calibrate the Furuta pendulum against measurements, draw furuta.png
	$(call develop,--profile quick --no-default-features)
	$(BIN)/python examples/furuta.py

test: lint test-rust test-python test-packaging  ## everything that must pass before a commit
	@echo; echo "all suites passed"

lint: $(VENV)/.tools  ## formatting, ruff, clippy, docs with warnings denied, the gate
	$(call suite,format,cargo fmt --all --check)
	$(call suite,gate,$(BIN)/python tools/gate.py)
	$(call suite,ruff,$(BIN)/ruff check --quiet)
	$(call suite,clippy,cargo clippy --workspace --all-targets --quiet -- -D warnings)
	$(call suite,rustdoc,RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --quiet)
	@! command -v x86_64-w64-mingw32-gcc >/dev/null || ! rustup target list --installed | grep -q $(WINDOWS) || $(MAKE) --no-print-directory lint-windows

lint-windows:  ## the command line compiles for Windows; wants `rustup target add x86_64-pc-windows-gnu` and mingw, or CC_x86_64_pc_windows_gnu
	$(call suite,windows,cargo check --quiet --target $(WINDOWS) --package fmufit-cli)

test-rust:  ## unit tests, black-box tests, doctests, examples
	$(call suite,cargo test,cargo test --workspace --quiet)
	$(call suite,rust examples,for e in $(basename $(notdir $(wildcard examples/*.rs))); do \
		$${CARGO_TARGET_DIR:-target}/debug/examples/$$e >/dev/null || exit 1; done)

test-python: $(VENV)/.tools  ## pytest, stub check, examples
	$(call develop)
	$(call suite,pytest,$(BIN)/python -m pytest -q crates/pydfo/tests)
	$(call suite,stubs,$(BIN)/python -m mypy.stubtest pydfo && $(BIN)/python -m mypy --strict crates/pydfo/python/pydfo)
	$(call suite,python examples,for e in $(wildcard examples/*.py); do MPLBACKEND=Agg $(BIN)/python $$e >/dev/null || exit 1; done)

test-packaging: $(VENV)/.tools  ## the source distribution builds and works in an empty environment elsewhere
	$(call suite,packaging,bash tools/packaging.sh $(BIN))

test-engines: $(VENV)/.tools $(ENGINES)/.done  ## fits on Dask, Ray, IPyParallel, joblib and MPI; engines that cannot be installed are skipped
	@VIRTUAL_ENV=$(CURDIR)/$(ENGINES) $(BIN)/maturin develop --quiet --manifest-path crates/pydfo/Cargo.toml
	$(call suite,engines,$(ENGINES)/bin/python -m pytest -q -rs crates/pydfo/tests/test_executors.py)

# $(call worker,folder,target,compiler,variables): builds the worker program of a target.
define worker
	$(call suite,worker for $(1),$(4) cargo build --quiet --profile quick --target $(2) --package fmufit-calibration --bin fmufit-worker)
	@mkdir -p $(WORKER_FOLDER)/$(1) && cp target/$(2)/quick/fmufit-worker.exe $(WORKER_FOLDER)/$(1)
	@$(3) -O2 -shared -o $(WORKER_FOLDER)/$(1)/bcryptprimitives.dll tools/bcryptprimitives.c -ladvapi32 -Wl,--kill-at
	@echo "wrote $(WORKER_FOLDER)/$(1)/fmufit-worker.exe"
endef

windows-worker:  ## the program that runs models of Windows under Wine, into ~/.local/share; wants mingw and `rustup target add x86_64-pc-windows-gnu`
	$(call worker,win64,$(WINDOWS),x86_64-w64-mingw32-gcc,$(MINGW))

windows-worker-32:  ## the same for 32-bit models; wants mingw and `rustup target add i686-pc-windows-gnu`
	$(call worker,win32,$(WINDOWS_32),i686-w64-mingw32-gcc,$(MINGW_32))

# WINDOWS_PYTHON: path of a python.exe with NumPy and pytest.
windows-python: export WINEPREFIX := $(CURDIR)/target/wine
windows-python: export WINEDEBUG := -all
windows-python: $(VENV)/.tools  ## the tests of the Python module under Wine; wants WINDOWS_PYTHON=path/python.exe
	@bash tools/wine_prefix.sh $(WINE) $(WINEPREFIX)
	$(call suite,Python tests under Wine,bash tools/windows_python.sh $(WINE) $(abspath $(WINDOWS_PYTHON)) $(BIN))

# Not empty if 32-bit programs can be compiled and run.
HAS_32 = $(and $(shell command -v i686-w64-mingw32-gcc),$(shell rustup target list --installed | grep $(WINDOWS_32)),$(shell ls target/wine/drive_c/windows/syswow64/ntdll.dll 2>/dev/null))

# The crates whose tests run under Wine.
WINDOWS_CRATES ?= base ode dfo fmi calibration cli
WINDOWS_BUILT := target/$(WINDOWS)/debug

# $(call under_wine,targets): makes them where Wine, MinGW and the Rust target are installed.
define under_wine
@if [ -x "$(WINE)" ] && command -v x86_64-w64-mingw32-gcc >/dev/null && rustup target list --installed | grep -q $(WINDOWS); \
then $(MAKE) --no-print-directory $(1); \
else echo "skipped $@: it needs wine64, mingw-w64 and rustup target add $(WINDOWS)"; fi
endef

test-windows:  ## everything for Windows under Wine; skipped without wine64, mingw and `rustup target add x86_64-pc-windows-gnu`
	$(call under_wine,wine-crates wine-fits wine-models)

windows-crates:  ## its first part, the tests of the crates, or of those in WINDOWS_CRATES
	$(call under_wine,wine-crates)

wine-crates wine-fits wine-models: export WINEPREFIX := $(CURDIR)/target/wine
wine-crates wine-fits wine-models: export WINEDEBUG := -all
wine-crates: $(VENV)/.tools
	@bash tools/wine_prefix.sh $(WINE) $(WINEPREFIX)
	$(call suite,tests under Wine,$(MINGW) CARGO_TARGET_X86_64_PC_WINDOWS_GNU_RUNNER=$(WINE) $(BIN)/python tools/wine_cc.py \
		cargo test --quiet --target $(WINDOWS) $(addprefix --package fmufit-,$(WINDOWS_CRATES)) --lib --bins --tests)

wine-fits: $(VENV)/.tools
	$(call develop)
	@bash tools/wine_prefix.sh $(WINE) $(WINEPREFIX)
	$(call suite,programs for Windows,$(MINGW) cargo build --quiet --target $(WINDOWS) --package fmufit-calibration --package fmufit-cli --bins)
	$(call suite,fits under Wine,WINE=$(WINE) $(BIN)/python tools/windows_check.py $(WINDOWS_BUILT)/fmufit.exe target/windows-check)

wine-models: $(VENV)/.tools
	$(call develop)
	@$(if $(HAS_32),:,echo "skipped 32-bit models: they need wine32 and a new target/wine; MinGW-w64 for i686; rustup target add $(WINDOWS_32)")
	@$(MAKE) --no-print-directory windows-worker $(if $(HAS_32),windows-worker-32) WORKER_FOLDER=target/wine-workers
	$(call suite,models for Windows,FMUFIT_WINE=$(WINE) $(BIN)/python tools/wine_check.py $(BIN)/fmufit target/wine-workers/win64/fmufit-worker.exe \
		target/wine-check $(if $(HAS_32),target/wine-workers/win32/fmufit-worker.exe))

test-long: $(VENV)/.tools build  ## what takes long: many runs, memory
	$(call suite,long rust tests,cargo test --workspace --release --quiet -- --ignored)
	$(call suite,long python tests,$(BIN)/python -m pytest -q -m long crates/pydfo/tests)

bench: build benches/env/.venv/.done  ## side by side with the peers, in one run
	benches/env/.venv/bin/python benches/against_fmpy.py
	benches/env/.venv/bin/python benches/against_fmpy_fit.py
	benches/env/.venv/bin/python benches/two_recordings.py
	benches/env/.venv/bin/python benches/open_large.py
	benches/env/.venv/bin/python benches/dae.py
	benches/env/.venv/bin/python benches/instructions.py --few 10 --many 40 --compare
	cargo bench --workspace

bench-dfo: benches/env/.venv/.done  ## the optimisers beside their peers; BENCH_DFO="--set more-wild" for a part
	benches/env/.venv/bin/python benches/dfo/run.py $(BENCH_DFO) $(if $(BENCH_DFO),,--write)
	$(if $(BENCH_DFO),,benches/env/.venv/bin/python benches/dfo/workers.py)

# Both want a nightly compiler; what each seed and each finding of the fuzzer showed is replayed by `make test`.
FUZZ_SECONDS ?= 600
FUZZ_FLAGS = -max_total_time=$(FUZZ_SECONDS) -timeout=10 -rss_limit_mb=256 -max_len=65536 -print_final_stats=1
HOST = $(shell rustc -vV | sed -n 's/^host: //p')

fuzz: nightly  ## fuzz archives and descriptions, FUZZ_SECONDS=600 each; wants nightly Rust
	@cargo fuzz --version >/dev/null 2>&1 || cargo install --locked --quiet cargo-fuzz
	@mkdir -p $(addprefix fuzz/corpus/,archive archive_entries description)
	$(call suite,fuzz description,ASAN_OPTIONS=quarantine_size_mb=16 cargo +nightly fuzz run description \
		fuzz/corpus/description fuzz/seeds/description -- $(FUZZ_FLAGS) -dict=fuzz/xml.dict)
	$(call suite,fuzz archive,ASAN_OPTIONS=quarantine_size_mb=16 cargo +nightly fuzz run archive \
		fuzz/corpus/archive fuzz/seeds/archive -- $(FUZZ_FLAGS))
	$(call suite,fuzz archive_entries,ASAN_OPTIONS=quarantine_size_mb=16 cargo +nightly fuzz run archive_entries \
		fuzz/corpus/archive_entries -- $(FUZZ_FLAGS))

# With frame pointers the stacks of what leaks reach up to the test, whose name decides whether it is meant to.
sanitize: nightly  ## the importer's tests under AddressSanitizer, LeakSanitizer, valgrind; wants nightly Rust
	$(call suite,sanitize,RUSTFLAGS="-Zsanitizer=address -Cforce-frame-pointers=yes" ASAN_OPTIONS=detect_leaks=1 \
		LSAN_OPTIONS=suppressions=$(CURDIR)/tools/sanitize.supp:print_suppressions=0 \
		cargo +nightly test --quiet -p fmufit-fmi --tests --target $(HOST) --target-dir target/sanitize)
	@command -v valgrind >/dev/null || { echo "valgrind is missing; install it to check accesses of C code to our buffers"; exit 1; }
	$(call suite,valgrind,CARGO_TARGET_$(subst -,_,$(shell echo $(HOST) | tr a-z A-Z))_RUNNER="valgrind -q --error-exitcode=9 --suppressions=$(CURDIR)/tools/valgrind.supp" \
		cargo test --quiet -p fmufit-fmi --tests)

nightly:
	@rustc +nightly --version >/dev/null 2>&1 || { echo "a nightly compiler is missing; run: rustup toolchain install nightly"; exit 1; }

doc: $(SITE)/.done  ## the site of guides and reference, in target/site; refuses dead links
	$(call suite,rustdoc,cargo doc --workspace --no-deps --quiet)
	$(call suite,site,NO_MKDOCS_2_WARNING=1 $(SITE)/bin/mkdocs build --strict --quiet && rm -rf target/site/rust && cp -r target/doc target/site/rust)
	$(call suite,links,$(SITE)/bin/python tools/doc_site.py target/site)
	@echo; echo "target/site/index.html; to use its search, run: $(PYTHON) -m http.server -d target/site"

pictures: build  ## draws the pictures of docs/ anew
	$(BIN)/python docs/pictures.py

build: $(VENV)/.demo  ## the Python module, installed into .venv
	$(call develop,--release)

$(VENV)/.demo: crates/pydfo/requirements-demo.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(0 if v >= (3, 10) else f"Python 3.10 or newer is needed, this is {v[0]}.{v[1]}")'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -r $<
	@touch $@

$(VENV)/.tools: crates/pydfo/requirements-dev.txt $(VENV)/.demo
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -r $<
	@touch $@

$(SITE)/.done: crates/pydfo/requirements-docs.txt
	@test -x $(SITE)/bin/python || $(PYTHON) -m venv $(SITE)
	@$(SITE)/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	@touch $@

# An engine may have no package for this platform or version of Python.
$(ENGINES)/.done: crates/pydfo/requirements-engines.txt
	@test -x $(ENGINES)/bin/python || $(PYTHON) -m venv $(ENGINES)
	@grep -v '^#' $< | while read -r package; do \
		$(ENGINES)/bin/python -m pip install --quiet --disable-pip-version-check "$$package" || echo "$$package cannot be installed; its tests are skipped"; done
	@touch $@

benches/env/.venv/.done: benches/env/requirements.txt $(VENV)/.tools
	@test -x benches/env/.venv/bin/python || $(PYTHON) -m venv benches/env/.venv
	@benches/env/.venv/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	@$(BIN)/maturin build --release --quiet --manifest-path crates/pydfo/Cargo.toml --out target/wheels
	@benches/env/.venv/bin/python -m pip install --quiet --disable-pip-version-check --force-reinstall --no-deps target/wheels/*.whl
	@touch $@

clean:  ## remove what was built and fetched
	rm -rf target $(VENV) benches/env/.venv out
