# Two commands: `make demo` and `make test`; `make bench`, `make soak`, `make fuzz`, `make fuzz-readers`, `make sanitize` and `make coverage` measure. Each sets up all that it needs, in .venv and build/,
# with nothing on the machine but Python 3.11 (with its headers), make and a C++20 compiler. `make PYTHON=python3.12 test` takes
# another Python.

PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check

# An edited C++ file is compiled again. Edited Python is live, but an editable install knows its modules by name, so it is renewed
# when a Python file comes or goes.
CORE := $(wildcard runtime/CMakeLists.txt runtime/*.in runtime/src/* runtime/include/palmar/*)
MODULES := $(sort $(wildcard runtime/palmar/*.py tools/*.py traces/*.py eval/*.py))

.PHONY: demo test fuzz fuzz-readers sanitize bench programs lint tidy licences sbom lowest wheels coverage coverage-fuzz soak format clean names

demo: .venv/installed
	@echo "== demo: built-in objects, a scripted grasp, replay, report"
	@$(BIN)/palmar demo -o demo

test: programs
	@echo "== C++ tests"
	@$(BIN)/ctest --test-dir build/tests --output-on-failure --parallel 2
	@echo "== Python tests"
	@$(BIN)/python -m pytest

# A million steps of random motion with a fresh seed; `make fuzz FUZZ='--object cup --seconds 600'` for another kind.
FUZZ ?= --steps 1000000
fuzz: programs
	@build/tests/fuzz_step $(FUZZ)

# The readers under clang's fuzzer (apt: clang-19 libclang-rt-19-dev), SECONDS each with the checks of undefined behaviour and of the bounds of
# containers alone, then all that this found, and SECONDS more, with those of memory too. Inputs stay in build/fuzz/NAME, those that fail beside
# it. They are no longer than a sound file with everything in it needs, since long ones take longer.
SECONDS ?= 60
FUZZERS := trace pack cdr settings
FUZZ_CHECKS := fuzz-undefined fuzz
LONGEST_trace := 8500
LONGEST_pack := 4500
LONGEST_cdr := 1000
LONGEST_settings := 1000
fuzz-readers: .venv/installed
	@$(foreach checks,$(FUZZ_CHECKS),PATH="$(CURDIR)/$(BIN):$$PATH" cmake -S runtime -B build/$(checks) -G Ninja -DCMAKE_CXX_COMPILER=clang++-19 \
	  -DPALMAR_TESTS=ON -DPALMAR_SANITIZE=$(checks) -DPython_EXECUTABLE="$(CURDIR)/$(BIN)/python" -DCMAKE_MAKE_PROGRAM="$(CURDIR)/$(BIN)/ninja" \
	  --log-level=WARNING >/dev/null && $(BIN)/cmake --build build/$(checks) --target $(addprefix fuzz_,$(FUZZERS)) -- --quiet &&) true
	@$(foreach checks,$(FUZZ_CHECKS),$(foreach name,$(FUZZERS),mkdir -p build/fuzz/$(name) && build/$(checks)/fuzz_$(name) -max_total_time=$(SECONDS) \
	  -max_len=$(LONGEST_$(name)) -reduce_inputs=0 -reload=0 -rss_limit_mb=2048 -print_final_stats=1 -artifact_prefix=build/fuzz/$(name)- \
	  build/fuzz/$(name) tests/fuzz/saved/$(name) &&)) true

# Lines and branches of the readers that those inputs reach; no fuzzer is needed, but what one left in build/fuzz.
READERS := mcap_reader|mcap\.h|trace_file|run_file|channels|schemas|cdr|utf8|pack_file|settings
coverage-fuzz: .venv/audit
	@PATH="$(CURDIR)/$(BIN):$$PATH" cmake -S runtime -B build/coverage-fuzz -G Ninja -DPALMAR_TESTS=ON -DCMAKE_BUILD_TYPE=Plain -DCMAKE_CXX_FLAGS="--coverage -O0" \
	  -DPython_EXECUTABLE="$(CURDIR)/$(BIN)/python" -DCMAKE_MAKE_PROGRAM="$(CURDIR)/$(BIN)/ninja" --log-level=WARNING >/dev/null
	@$(BIN)/cmake --build build/coverage-fuzz --target $(addprefix replay_,$(FUZZERS)) -- --quiet
	@find build/coverage-fuzz -name '*.gcda' -delete
	@$(foreach name,$(FUZZERS),build/coverage-fuzz/replay_$(name) tests/fuzz/saved/$(name) && build/coverage-fuzz/replay_$(name) build/fuzz/$(name) &&) true
	@$(BIN)/gcovr --root runtime --filter 'runtime/src/($(READERS))' build/coverage-fuzz --exclude-throw-branches --print-summary

# The C++ tests under checks of memory and of undefined behaviour (address), then under a detector of races (thread).
SANITIZE ?= address thread
sanitize: .venv/installed
	@$(foreach checks,$(SANITIZE),PATH="$(CURDIR)/$(BIN):$$PATH" cmake -S runtime -B build/$(checks) -G Ninja -DPALMAR_TESTS=ON -DPALMAR_SANITIZE=$(checks) -DCMAKE_BUILD_TYPE=Plain \
	  -DPython_EXECUTABLE="$(CURDIR)/$(BIN)/python" -DCMAKE_MAKE_PROGRAM="$(CURDIR)/$(BIN)/ninja" --log-level=WARNING >/dev/null && \
	  $(BIN)/cmake --build build/$(checks) -- --quiet && $(BIN)/ctest --test-dir build/$(checks) --output-on-failure &&) true

# What a step costs. `make bench BENCH='--scene ears --set iterations=2'`; more arguments stand at the top of its source.
BENCH ?=
bench: programs
	@build/tests/bench_step $(BENCH)

programs: .venv/installed
	@echo "== C++ tests and measuring programs (build/tests)"
	@PATH="$(CURDIR)/$(BIN):$$PATH" cmake -S runtime -B build/tests -G Ninja -DPALMAR_TESTS=ON -DPALMAR_SHARED=ON -DCMAKE_BUILD_TYPE=Release -DCMAKE_EXPORT_COMPILE_COMMANDS=ON \
	  -DPython_EXECUTABLE="$(CURDIR)/$(BIN)/python" -DCMAKE_MAKE_PROGRAM="$(CURDIR)/$(BIN)/ninja" --log-level=WARNING >/dev/null
	@$(BIN)/cmake --build build/tests -- --quiet

lint: .venv/linters
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run --Werror $(wildcard runtime/src/*.cpp runtime/src/*.h runtime/include/palmar/*.h tests/runtime/*.cpp tests/runtime/*.h tests/consumer/*.c tests/fuzz/*.cpp tests/fuzz/*.h)
	$(BIN)/mypy

# Some minutes: not part of lint. Its checks, and why these, stand in .clang-tidy. A folder of its own, configured and not built, names
# each file once and the Python module's too; in build/tests some stand four times, once for each instruction set.
tidy: .venv/audit
	@PATH="$(CURDIR)/$(BIN):$$PATH" cmake -S runtime -B build/tidy -G Ninja -DPALMAR_PYTHON=ON -DCMAKE_BUILD_TYPE=Release -DCMAKE_EXPORT_COMPILE_COMMANDS=ON \
	  -DPython_EXECUTABLE="$(CURDIR)/$(BIN)/python" -DCMAKE_MAKE_PROGRAM="$(CURDIR)/$(BIN)/ninja" --log-level=WARNING >/dev/null
	@$(BIN)/python $(BIN)/run-clang-tidy.py -quiet -j $(TIDY) -clang-tidy-binary $(BIN)/clang-tidy -p build/tidy 'runtime/src/[^/]*\.cpp$$'
TIDY ?= 2

# What an installation brings, and under which licence; as CycloneDX in build/sbom.json.
licences: .venv/installed
	@$(BIN)/python tests/supply.py licences > docs/licences.md

sbom: .venv/audit
	@$(BIN)/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible --output-file build/installed.json $(BIN)/python
	@$(BIN)/python tests/supply.py sbom < build/installed.json > build/sbom.json

# The oldest versions that pyproject.toml allows, those of the build too, in an environment of their own, and the tests that meet
# them most: each package is met by one of these at least.
lowest: .venv/installed
	@$(PYTHON) -m venv --clear build/lowest
	@$(BIN)/python tests/supply.py lowest > build/lowest/pins.txt
	@build/lowest/bin/python -m pip --quiet --disable-pip-version-check install -r build/lowest/pins.txt
	@PATH="$(CURDIR)/$(BIN):$$PATH" build/lowest/bin/python -m pip --quiet --disable-pip-version-check wheel . --no-build-isolation --no-deps \
	  --wheel-dir build/lowest/wheel --config-settings build-dir=build/lowest/core
	@build/lowest/bin/python -m pip --quiet --disable-pip-version-check install build/lowest/wheel/*.whl -r build/lowest/pins.txt
	@build/lowest/bin/python -m pytest -p no:cacheprovider $(LOWEST)
LOWEST ?= tests/test_cli.py tests/test_bad_input.py tests/test_tables.py tests/tools/test_mesh.py tests/tools/test_pack.py \
  tests/tools/test_shapes.py tests/tools/test_hand_fit.py tests/traces/test_column_map.py tests/traces/test_isaac_teleop.py \
  tests/traces/test_record.py tests/runtime/test_qp_daqp.py tests/runtime/test_trace_files.py tests/eval/test_maps.py tests/eval/test_report.py

# One wheel for each Python that is here, tried with the newest libraries; what is not here is said. Others are named by path:
# `make wheels WHEELS="$$HOME/.pyenv/versions/3.13.0/bin/python"`.
WHEELS ?= python3.11 python3.12 python3.13 python3.14
wheels:
	@$(PYTHON) tests/wheels.py build/wheels $(WHEELS) -- tests/test_cli.py tests/test_tables.py tests/tools/test_mesh.py

# Lines and branches that all tests reach, of the core by gcc's counters and of Python by coverage.py, in one run: Python's tests drive
# much of the core. In an environment of its own, whose core counts. `make coverage TESTS=tests/eval` for a part of Python's tests.
COUNTED := build/coverage/env/bin
TESTS ?= tests
FULL_DISK := tests/traces/test_glove.py::test_a_full_disk_costs_the_end_alone_and_exit_code_3# where the counter has no room either
coverage: .venv/audit programs
	@$(PYTHON) -m venv build/coverage/env
	@$(COUNTED)/python -m pip --quiet --disable-pip-version-check install -r .venv/build-requires.txt -r .venv/audit-requires.txt cmake ninja
	@PATH="$(CURDIR)/$(COUNTED):$$PATH" $(COUNTED)/python -m pip --quiet --disable-pip-version-check install --no-build-isolation -e '.[test]' \
	  -C build-dir=build/coverage/core -C cmake.build-type=Plain -C cmake.define.PALMAR_TESTS=ON -C cmake.define.CMAKE_CXX_FLAGS="--coverage -O1"
	@find build/coverage/core -name '*.gcda' -delete; $(COUNTED)/coverage erase
	@$(COUNTED)/ctest --test-dir build/coverage/core --output-on-failure --parallel 2
	@$(COUNTED)/coverage run -m pytest -p no:cacheprovider --deselect $(FULL_DISK) $(TESTS)
	@$(COUNTED)/coverage combine --quiet && $(COUNTED)/coverage json --quiet -o build/coverage/python.json
	@$(COUNTED)/gcovr --root runtime --filter runtime/src --exclude-throw-branches --gcov-ignore-parse-errors=negative_hits.warn_once_per_file \
	  build/coverage/core --json build/coverage/core.json
	@$(COUNTED)/python tests/reached.py

# Ten minutes at 1 kHz: flat memory, and how late a frame is. `make soak SOAK=3600` for the hour.
SOAK ?= 600
soak: programs
	@build/tests/bench_soak $(SOAK)

format: .venv/linters
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(wildcard runtime/src/*.cpp runtime/src/*.h runtime/include/palmar/*.h tests/runtime/*.cpp tests/runtime/*.h tests/consumer/*.c tests/fuzz/*.cpp tests/fuzz/*.h)

clean:
	rm -rf .venv build demo

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "Palmar needs Python 3.11 or later, and $(PYTHON) is not. Name another: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 2; }
	@echo "== Python environment in .venv"
	@$(PYTHON) -m venv .venv

# What the build itself needs comes from pip too (cmake and ninja with it), and stays, so that the next build compiles only what changed.
.venv/build-tools: pyproject.toml | .venv/bin/python
	@echo "== tools for the build (pip)"
	@$(BIN)/python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"], sep="\n")' > .venv/build-requires.txt
	@$(PIP) install -r .venv/build-requires.txt cmake ninja
	@touch $@

.venv/installed: .venv/build-tools .venv/modules $(CORE)
	@echo "== building the C++ core and installing palmar with its libraries (the first time takes some minutes)"
	@PATH="$(CURDIR)/$(BIN):$$PATH" $(PIP) install --no-build-isolation -e '.[test]'
	@touch $@

.venv/modules: names | .venv/bin/python
	@echo '$(MODULES)' | cmp -s - $@ || echo '$(MODULES)' > $@

.venv/linters .venv/audit: pyproject.toml | .venv/installed
	@echo "== tools of $(subst .venv/linters,lint,$(subst .venv/audit,audit,$@)) (pip)"
	@$(BIN)/python -c 'import sys, tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"][sys.argv[1]], sep="\n")' \
	  $(subst .venv/linters,lint,$(subst .venv/audit,audit,$@)) > $@-requires.txt
	@$(PIP) install -r $@-requires.txt
	@touch $@
