# One command each. `make help` lists them; CI runs the same ones.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
MAKEFLAGS += --no-print-directory
.DEFAULT_GOAL := help

PYTHON ?= python3
VENV ?= .venv
JOBS ?= $(shell nproc 2>/dev/null || echo 2)
# One version for everyone, so that figures can be compared. On Linux the default index serves
# the CUDA build (gigabytes); a CPU build is enough:
#   make setup TORCH_INDEX=<the CPU index named on pytorch.org>
TORCH ?= torch==2.13.0
TORCH_INDEX ?=
# A file of versions to keep to, such as tools/oldest.txt (with TORCH=torch).
CONSTRAINTS ?=
DEMO_OUT ?= out/demo
# A later -n counts: PYTEST_ARGS="-n0 -k glints" runs in one process, where pdb works.
PYTEST_ARGS ?=
# Of `make fuzz`, and which readers (tests/fuzzing/readers.py); all when empty.
SECONDS ?= 60
READERS ?=
export PYTHON

bin := $(VENV)/bin
pip := $(bin)/python -m pip --disable-pip-version-check
cpp_folders := cpp $(wildcard bench/cpp)
cpp_sources := $(shell find $(cpp_folders) cmake \
  \( -name '*.cpp' -o -name '*.hpp' -o -name '*.txt' -o -name '*.cmake' \))
cpp_format := $(shell find $(cpp_folders) -name '*.cpp' -o -name '*.hpp')
build_dir := build/editable
constraint := $(if $(CONSTRAINTS),--constraint $(CONSTRAINTS))
# Warnings are errors in CI only: a newer compiler must not stop a user. There the benchmarks are
# compiled too, though not run: shared machines time nothing well, but they must not rot.
werror := $(if $(CI),ON,OFF)

## help: list the commands
.PHONY: help
help:
	@sed -n 's/^## //p' Makefile

## setup: system packages, .venv with every dependency, native build
.PHONY: setup
setup: $(VENV)/.built

.PHONY: system
system:
	@tools/system_packages.sh

$(VENV)/bin/python: | system
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "geraf2 needs Python 3.11 or newer; name one: make PYTHON=python3.11 $(MAKECMDGOALS)" >&2; exit 1; }
	@echo "making $(VENV)"
	@"$(PYTHON)" -m venv "$(VENV)"
	@$(pip) install -qq --upgrade 'pip>=25.1'

# What CI builds and judges with comes by its hashes; the groups below then ask for no more of it.
$(VENV)/.deps: pyproject.toml tools/locked.txt $(VENV)/bin/python
	@echo "installing Python packages (torch is the large one)"
	@$(pip) install -qq --require-hashes --requirement tools/locked.txt
	@$(pip) install -qq $(TORCH) $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX)) $(constraint)
	@$(pip) install -qq $$($(bin)/python tools/requirements.py) $(constraint) \
	  --group build --group test --group lint
	@touch $@

# Editable: Python sources are used where they lie; only C++ and CMake changes build again,
# and build_dir keeps what is compiled, so that this costs no more than the changed files.
$(VENV)/.built: $(VENV)/.deps $(cpp_sources) CMakeLists.txt $(VENV)/.ci-$(werror)
	@echo "building geraf2"
	@$(pip) install -qq --no-build-isolation --no-deps --editable . \
	  --config-settings=build-dir=$(build_dir) \
	  --config-settings=cmake.define.GERAF2_BUILD_TESTS=AUTO \
	  --config-settings=cmake.define.GERAF2_BUILD_BENCH=$(if $(CI),AUTO,OFF) \
	  --config-settings=cmake.define.GERAF2_WERROR=$(werror)
	@touch $@

$(VENV)/.ci-$(werror): $(VENV)/bin/python
	@rm -f $(VENV)/.ci-*
	@touch $@

## demo: simulate a carton with a figure inside, reconstruct it, write a report
.PHONY: demo
demo: setup
	@$(bin)/geraf2 demo $(DEMO_OUT)

## test: C++ tests, then Python tests
.PHONY: test
test: cpp-test
	@# worksteal: halves of the list in its order, so that a file's fixtures are made once
	@$(bin)/python -m pytest -n $(JOBS) --dist worksteal $(PYTEST_ARGS)

## coverage: the same, and a table of the lines that the Python tests run, by package
.PHONY: coverage
coverage: cpp-test
	@mkdir -p build/coverage
	@$(bin)/python -m pytest -n $(JOBS) --dist worksteal --cov=geraf2 --cov-report= $(PYTEST_ARGS)
	@$(bin)/python -m coverage json -q -o build/coverage/report.json
	@$(bin)/python tools/coverage_table.py build/coverage/report.json

## cpp-test: C++ tests alone
.PHONY: cpp-test
cpp-test: setup
	@ctest --test-dir $(build_dir) --output-on-failure --parallel $(JOBS) --no-tests=ignore

## fuzz: fuzz the readers for SECONDS=60; what is found goes to tests/fuzzing/crashes
.PHONY: fuzz
fuzz: setup
	@$(pip) install -qq --group fuzz
	@$(bin)/python tools/fuzz.py --seconds $(SECONDS) $(READERS)

## fuzz-quick: 10,000 executions, the same ones each time, for CI
.PHONY: fuzz-quick
fuzz-quick: setup
	@$(pip) install -qq --group fuzz
	@$(bin)/python tools/fuzz.py --runs 10000

## audit: known vulnerabilities of what is installed; asks the package registry
.PHONY: audit
audit: setup
	@$(pip) install -qq pip-audit
	@$(bin)/python tools/audit.py

## lock: newest versions of the tools for building and checking, with hashes, in tools/locked.txt
.PHONY: lock
lock: $(VENV)/bin/python
	@$(pip) install -qq uv
	@$(bin)/uv pip compile --quiet --generate-hashes --universal --python-version 3.11 --upgrade \
	  --custom-compile-command "make lock" --group build --group lint --output-file tools/locked.txt

## sanitize: C++ tests under the address and undefined-behaviour sanitizers
.PHONY: sanitize
sanitize: system
	@cmake --preset sanitize >/dev/null
	@cmake --build --preset sanitize --parallel $(JOBS)
	@ctest --preset sanitize --parallel $(JOBS)

## planted-bugs: bugs in a copy of the kernels, each of which tests or sanitizers must report
.PHONY: planted-bugs
planted-bugs: system
	@python3 tools/planted_bugs.py --jobs $(JOBS)

.PHONY: thread-system
thread-system: system
	@tools/system_packages.sh thread

## thread-check: C++ tests under the thread sanitizer, by clang
.PHONY: thread-check
thread-check: thread-system
	@cmake --preset thread >/dev/null
	@cmake --build --preset thread --parallel $(JOBS)
	@ctest --preset thread

## arm64-check: compile for arm64 and run the C++ tests there, by qemu (apt: g++-aarch64-linux-gnu qemu-user)
.PHONY: arm64-check
arm64-check: system
	@cmake --preset arm64 >/dev/null
	@cmake --build --preset arm64 --parallel $(JOBS)
	@ctest --preset arm64

## lint: formatting, static checks, layers, spelling, links
.PHONY: lint
lint: setup
	@# every check runs, so that one run shows all that is wrong
	@failed=(); check() { "$$@" || failed+=("$$(basename "$$1") $$2"); }; \
	check $(bin)/python tools/check_links.py; \
	if git rev-parse --git-dir >/dev/null 2>&1; then check $(bin)/python tools/check_files.py; fi; \
	check $(bin)/ruff format --check --quiet; \
	check $(bin)/ruff check --quiet; \
	check $(bin)/mypy --no-error-summary; \
	check $(bin)/lint-imports --no-cache --no-logo; \
	check $(bin)/clang-format --dry-run -Werror $(cpp_format); \
	check $(bin)/codespell $$(git ls-files 2>/dev/null || echo README.md docs python cpp tests); \
	if [ $${#failed[@]} -gt 0 ]; then printf 'failed: %s\n' "$${failed[@]}" >&2; exit 1; fi

## tidy: clang-tidy on every C++ source
.PHONY: tidy
tidy: setup
	@# omp.h belongs to gcc; looked for last, so that clang keeps its own intrinsics
	@# CMake wrote the files of each instruction set into the build folder
	@find cpp/src cpp/bindings/of_* $(build_dir)/cpp/levels -name '*.cpp' -print0 | sort -zr | \
	  xargs -0 -n 1 -P $(JOBS) $(bin)/clang-tidy -p $(build_dir) --quiet \
	  --extra-arg=-idirafter"$$(c++ -print-file-name=include)" 2>&1 | \
	  { grep -Ev '^[0-9]+ warnings (and [0-9]+ errors? )?generated|^Suppressed' || true; }

## format: rewrite sources in the project's format
.PHONY: format
format: setup
	@$(bin)/ruff format --quiet
	@$(bin)/ruff check --quiet --fix
	@$(bin)/clang-format -i $(cpp_format)

## docs-check: every relative link in the documentation leads somewhere
.PHONY: docs-check
docs-check:
	@"$(PYTHON)" tools/check_links.py

## docs: the documentation site in build/docs; its gallery is shown, not run
.PHONY: docs
docs: setup $(VENV)/.docs
	@$(bin)/python -m sphinx -b html -W --keep-going -q docs build/docs
	@$(bin)/python tools/check_docs.py build/docs

## docs-full: the same with the gallery run and drawn, minutes
.PHONY: docs-full
docs-full:
	@GERAF2_GALLERY=run $(MAKE) docs

$(VENV)/.docs: pyproject.toml $(VENV)/.deps
	@$(pip) install -qq --group docs
	@touch $@

## dist: source distribution and wheel in dist/
.PHONY: dist
dist: $(VENV)/.deps
	@rm -rf dist
	@$(bin)/python -m build --no-isolation --outdir dist \
	  --config-setting=cmake.define.GERAF2_WERROR=$(werror) . | tail -n 1

## sdist: source distribution alone, in dist/
.PHONY: sdist
sdist: $(VENV)/.deps
	@rm -rf dist
	@$(bin)/python -m build --no-isolation --sdist --outdir dist . | tail -n 1

## github-release: the release of TAG on GitHub, with the files of dist/ (needs gh)
.PHONY: github-release
github-release:
	@gh release create "$(TAG)" dist/* --verify-tag --generate-notes --title "geraf2 $(TAG)"

## dist-check: build the wheel from the sdist, install it apart, import it
.PHONY: dist-check
dist-check: dist
	@$(bin)/python tools/check_wheel.py dist

## bench: kernel benchmarks (Google Benchmark), then whole steps
.PHONY: bench
bench: setup
	@cmake --preset bench >/dev/null
	@cmake --build --preset bench --parallel $(JOBS)
	@for program in build/bench/bench/cpp/geraf2_bench*; do "$$program"; done

## bench-quick: short form of `geraf2 benchmark`: tables of methods over simulated scenes
.PHONY: bench-quick
bench-quick: setup
	@$(bin)/geraf2 benchmark out/bench-quick --quick --jobs 2

## clean: remove everything that make made
.PHONY: clean
clean:
	@rm -rf $(VENV) build dist out .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
