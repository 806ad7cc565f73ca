# Two commands for a new machine with Python 3.11 or newer, a Rust toolchain and make:
#   make demo   builds everything and runs a demo: a scene, a clipping camera, four estimators
#   make test   runs every check of this project
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CORE := $(shell find crates -name '*.rs' -o -name Cargo.toml) Cargo.toml pyproject.toml

.PHONY: help install demo test test-install lint types rust-test py-test test-slow faults fuzz live-faults kills mutants format \
	bench experiments docs gallery screenshots wheel wheel-test wheel-demo wheel-arm64 wheel-windows \
	resources system-deps clean

help:
	@grep -E '^[a-z0-9-]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 16

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit("lightmatrix needs Python 3.11 or newer, this is " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(BIN)/python $(CORE)
	@command -v cargo >/dev/null || { echo 'lightmatrix needs a Rust toolchain: see https://rustup.rs'; exit 1; }
	@echo 'Installing lightmatrix into $(VENV); compiling its Rust core takes minutes.'
	@$(BIN)/python -m pip install --disable-pip-version-check --progress-bar off --editable .
	@touch $@

$(VENV)/.test-installed: $(VENV)/.installed
	$(BIN)/python tools/requirements.py dev render docs response shape exr raw cluster viewer notebook | \
	  $(BIN)/python -m pip install --quiet --disable-pip-version-check -r /dev/stdin
	for extra in window aravis gentl video dslr; do \
	  $(BIN)/python tools/requirements.py $$extra | \
	    $(BIN)/python -m pip install --quiet --disable-pip-version-check -r /dev/stdin || \
	    { echo "$$extra cannot be installed (see make system-deps): its tests are skipped"; test -z "$$CI"; } \
	    || exit 1; \
	done
	@touch $@

$(VENV)/.docs-installed: $(VENV)/.installed
	$(BIN)/python tools/requirements.py docs | \
	  $(BIN)/python -m pip install --quiet --disable-pip-version-check -r /dev/stdin
	@touch $@

install: $(VENV)/.installed ## build lightmatrix into .venv

demo: install ## run the demo; then open demo/report.html
	$(BIN)/lightmatrix demo -o demo --overwrite

test-install: $(VENV)/.test-installed

test: test-install ## run every check: format, types, Rust, Python, README, wheel
	$(MAKE) --jobs=3 lint types rust-test wheel-demo
	$(MAKE) py-test

lint:
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --quiet -- -D warnings

types:
	$(BIN)/mypy

rust-test:
	cargo test --quiet --package lightmatrix-core --profile quick

# Three processes on two cores, as many tests wait for devices; one thread each for numerics. The
# commands that tests start import compiled bytecode, even where the environment forbids to keep it.
py-test:
	env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
	  $(BIN)/python -m pytest --numprocesses 3 --dist loadfile --no-loadscope-reorder

test-slow: test-install ## run the tests that are left out of `make test`: experiments, and long ones
	$(BIN)/python -m pytest -m slow

faults: test-install ## run the cases of faults: what must not be destroyed, and what must not destroy
	$(BIN)/python -m pytest --numprocesses 2 tests/faults

fuzz: test-install ## try 20,000 damaged inputs, or make fuzz N=500
	FUZZ=$(or $(N),20000) $(BIN)/python -m pytest --numprocesses 2 tests/faults/test_fuzz.py

live-faults: test-install ## capture 200 times with a rig that fails, or make live-faults N=20
	$(BIN)/python -m tests.rig.rig_faults --count $(or $(N),200)

kills: test-install ## kill 50 estimates and their workers at random moments, or make kills N=10
	$(BIN)/python -m tests.estimators.kills --count $(or $(N),50)
	$(BIN)/python -m tests.estimators.kills --count $(or $(N),50) --small --workers 2

mutants: test-install ## break 200 lines, one at a time: do tests notice 85 % of them?
	$(BIN)/python tools/mutants.py --count 200 --least 0.85

format: test-install ## format the sources
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	cargo fmt --all

bench: install ## measure the solver against its peers: table, JSON and plot in bench-out/
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python -m benchmarks

experiments: test-install ## make the paper's figures and ours in experiments-out/; continues if interrupted
	for name in fig4 fig5 fig6 fig7 few-patterns rigs responses uses shape; do \
	  test -e experiments-out/$$name/$$name.json || \
	  $(BIN)/python -m experiments $$name -o experiments-out/$$name || exit; done

docs: $(VENV)/.docs-installed ## build the documentation in site/; warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build
	@echo 'the documentation: run $(BIN)/python -m http.server --directory site, and open http://localhost:8000'

gallery: test-install ## run the examples, which draw docs/images/gallery
	$(BIN)/python tools/gallery.py

screenshots: test-install ## photograph the demo's report and the viewer for docs/images; needs a Chromium
	$(BIN)/python tools/report_screenshots.py
	$(BIN)/python tools/viewer_screenshots.py

# RUSTFLAGS is empty, so that the wheel runs on every processor of this system. The core chooses
# faster instructions at run time.
wheel: $(BIN)/python ## build a wheel for any CPU of this system in dist/
	@command -v cargo >/dev/null || { echo 'lightmatrix needs a Rust toolchain: see https://rustup.rs'; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'maturin>=1.12,<2'
	env -u CARGO_ENCODED_RUSTFLAGS RUSTFLAGS= $(BIN)/maturin build --release --locked --out dist
	cd dist && sha256sum *.whl > SHA256SUMS && cat SHA256SUMS

wheel-test: wheel ## test the wheel in an empty environment without a compiler
	$(PYTHON) tools/wheel_test.py dist $$(command -v qemu-x86_64 >/dev/null && echo --cpu Nehalem)

wheel-demo: wheel
	$(PYTHON) tools/wheel_test.py dist --quick

# Cross-compiled by zig and tested in emulation. On such a machine, use `make wheel-test`.
wheel-arm64: install ## build a wheel for 64-bit ARM and test it under qemu; takes ten minutes
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'maturin[zig]>=1.12,<2'
	rustup target add aarch64-unknown-linux-gnu
	PATH="$(CURDIR)/$(BIN):$$PATH" env -u CARGO_ENCODED_RUSTFLAGS RUSTFLAGS= $(BIN)/maturin build --release --locked \
	  --target aarch64-unknown-linux-gnu --zig --compatibility manylinux_2_28 --out dist/arm64
	$(BIN)/python tools/wheel_arm64.py dist/arm64

# Cross-compiled by MinGW and tested by Wine. On Windows, use `python tools/wheel_test.py dist`.
# WINDOWS_PYTHON=folder, with a CPython for Windows, also compares the wheel's results.
wheel-windows: install ## build a wheel for Windows and test the core under Wine
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'maturin>=1.12,<2'
	rustup target add x86_64-pc-windows-gnu
	env -u CARGO_ENCODED_RUSTFLAGS RUSTFLAGS= $(BIN)/maturin build --release --locked \
	  --target x86_64-pc-windows-gnu --out dist/windows
	$(BIN)/python tools/wheel_windows.py dist/windows $(if $(WINDOWS_PYTHON),--python $(WINDOWS_PYTHON))

resources: test-install ## hold the memory that estimates take against its bound; takes ten minutes
	$(BIN)/python -m benchmarks.resource_estimate

system-deps: ## install optional system packages: LLVM, a browser, screens, cameras
	bash tools/system-deps.sh

clean: ## remove everything that make made
	rm -rf $(VENV) target dist demo report site bench-out experiments-out mutants-out src/lightmatrix/_core*.so
