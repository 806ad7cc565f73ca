# Two commands for a fresh machine with Python >= 3.11, a Rust toolchain and make:
#   make demo   a scene, a clipping camera, four estimators, a report with pictures
#   make test   every check this project has
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CORE := $(shell find crates -name '*.rs' -o -name Cargo.toml) Cargo.toml pyproject.toml

.PHONY: help install demo test test-install lint types rust-test py-test faults fuzz live-faults kills mutants format \
	bench experiments docs gallery screenshots wheel wheel-test wheel-demo wheel-arm64 wheel-windows \
	needs system-deps clean

help:
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 16

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit("lightmatrix needs Python 3.11 or newer, this is " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(BIN)/python $(CORE)
	@command -v cargo >/dev/null || { echo 'lightmatrix needs a Rust toolchain: see https://rustup.rs'; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(VENV)/.test-installed: $(VENV)/.installed
	$(BIN)/python tools/requirements.py dev render docs response exr raw cluster | \
	  $(BIN)/python -m pip install --quiet --disable-pip-version-check -r /dev/stdin
	for extra in window aravis gentl video dslr; do \
	  $(BIN)/python tools/requirements.py $$extra | \
	    $(BIN)/python -m pip install --quiet --disable-pip-version-check -r /dev/stdin || \
	    { echo "no $$extra here (see make system-deps): its tests are skipped"; test -z "$$CI"; } \
	    || exit 1; \
	done
	@touch $@

install: $(VENV)/.installed ## build the core and install lightmatrix into .venv

demo: install ## simulate, estimate and evaluate a bundled scene; a report in report/
	$(BIN)/lightmatrix demo -o report --overwrite

test-install: $(VENV)/.test-installed

test: test-install ## every check: formats, types, Rust, Python, README, wheel
	$(MAKE) --jobs=2 lint types rust-test
	$(MAKE) py-test
	$(MAKE) wheel-demo

lint:
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --quiet -- -D warnings

types:
	$(BIN)/mypy

rust-test:
	cargo test --quiet --package lightmatrix-core --profile quick

# Two processes, since many tests of devices wait; what they calculate with takes one thread each.
py-test:
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
	  $(BIN)/python -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder

faults: test-install ## the table of faults, counted by what became of each
	$(BIN)/python -m tests.faults.table -v

fuzz: test-install ## N damaged inputs, 20,000 unless said: make fuzz N=500
	$(BIN)/python -m tests.faults.fuzz --count $(or $(N),20000)

live-faults: test-install ## N captures of a rig that fails and is killed, 200 unless said: make live-faults N=20
	$(BIN)/python -m tests.live.rig_faults --count $(or $(N),200)

kills: test-install ## N estimates killed at random moments, and N whose workers are; 50 unless said: make kills N=10
	$(BIN)/python -m tests.estimators.kills --count $(or $(N),50)
	$(BIN)/python -m tests.estimators.kills --count $(or $(N),50) --small --workers 2

mutants: test-install ## break 200 lines, one at a time: do tests notice 85 % of them?
	$(BIN)/python tools/mutants.py --count 200 --least 0.85

format: test-install ## rewrite the sources in the house format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	cargo fmt --all

bench: install ## the solver against its peers: table, JSON and plot in bench-out/
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python -m benchmarks

experiments: test-install ## the paper's figures and ours, in experiments-out/; goes on where it stopped
	for name in fig4 fig5 fig6 fig7 few-patterns rigs; do \
	  test -e experiments-out/$$name/$$name.json || \
	  $(BIN)/lightmatrix experiment $$name -o experiments-out/$$name || exit; done

docs: test-install ## the documentation as a site, in site/; warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build
	@echo 'the documentation: site/index.html'

gallery: test-install ## run the examples and keep their pictures in docs/images/gallery
	$(BIN)/python tools/gallery.py

screenshots: test-install ## of the demo's report, in docs/images; needs a Chromium
	$(BIN)/python tools/report_screenshots.py

# For the baseline of the system, whatever the shell or cargo's configuration ask for; faster
# instructions are chosen at run time.
wheel: $(BIN)/python ## a wheel for any CPU of this kind of system, with its checksum, in dist/
	@command -v cargo >/dev/null || { echo 'lightmatrix needs a Rust toolchain: see https://rustup.rs'; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'maturin>=1.12,<2'
	env -u CARGO_ENCODED_RUSTFLAGS RUSTFLAGS= $(BIN)/maturin build --release --locked --out dist
	cd dist && sha256sum *.whl > SHA256SUMS && cat SHA256SUMS

wheel-test: wheel ## install it into an empty environment without a compiler and run the demo from it
	$(PYTHON) tools/wheel_test.py dist $$(command -v qemu-x86_64 >/dev/null && echo --cpu Nehalem)

wheel-demo: wheel
	$(PYTHON) tools/wheel_test.py dist --quick

# Cross-compiled by zig, tried in emulation: on a machine with this processor, `make wheel-test`.
wheel-arm64: install ## a wheel for 64-bit ARM, and its results under qemu; takes ten minutes
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'maturin[zig]>=1.12,<2'
	rustup target add aarch64-unknown-linux-gnu
	PATH="$(CURDIR)/$(BIN):$$PATH" env -u CARGO_ENCODED_RUSTFLAGS RUSTFLAGS= $(BIN)/maturin build --release --locked \
	  --target aarch64-unknown-linux-gnu --zig --compatibility manylinux_2_28 --out dist/arm64
	$(BIN)/python tools/wheel_arm64.py dist/arm64

# Cross-compiled by MinGW, tried by Wine: on Windows, `python tools/wheel_test.py dist`.
wheel-windows: install ## a wheel for Windows, and the core's tests under Wine; WINDOWS_PYTHON=folder: its results, too
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'maturin>=1.12,<2'
	rustup target add x86_64-pc-windows-gnu
	env -u CARGO_ENCODED_RUSTFLAGS RUSTFLAGS= $(BIN)/maturin build --release --locked \
	  --target x86_64-pc-windows-gnu --out dist/windows
	$(BIN)/python tools/wheel_windows.py dist/windows $(if $(WINDOWS_PYTHON),--python $(WINDOWS_PYTHON))

needs: test-install ## measure what estimates take of memory and time; takes half an hour
	$(BIN)/python -m benchmarks.needs

system-deps: ## optional system packages (the renderer's LLVM, a browser, screens and cameras)
	bash tools/system-deps.sh

clean: ## remove what make made
	rm -rf $(VENV) target dist report site bench-out experiments-out mutants-out src/lightmatrix/_core*.so
