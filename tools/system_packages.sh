#!/usr/bin/env bash
# Makes sure of the compiler, CMake, Embree, the C++ test libraries, a compiler cache and a browser for tests.
#
# Each is looked for by what it provides, not by a package's name, so that a conda or a
# hand-made installation counts too. What is missing is installed through apt where that is
# possible (root, or sudo without a password); elsewhere the script says what to install.
# With the argument `thread`: what the thread sanitizer needs, and nothing else.
set -euo pipefail

has_header() { # a local prefix counts: the compiler reads CPATH and CPLUS_INCLUDE_PATH
    command -v "${CXX:-c++}" >/dev/null &&
        printf '#include <%s>\n' "$1" | "${CXX:-c++}" -std=c++20 -E -x c++ - >/dev/null 2>&1
}
has_embree() {
    has_header embree4/rtcore.h || has_header embree3/rtcore.h || [ -n "${embree_DIR:-}" ]
}
has_cxx() { command -v "${CXX:-c++}" >/dev/null; }
has_python_headers() {
    local include
    include=$("${PYTHON:-python3}" -c 'import sysconfig; print(sysconfig.get_path("include"))')
    [ -f "$include/Python.h" ]
}
has_browser() {
    local name
    for name in chromium chromium-browser google-chrome; do
        if command -v "$name" >/dev/null; then return 0; fi
    done
    return 1
}
has_venv() { "${PYTHON:-python3}" -c 'import ensurepip, venv' 2>/dev/null; }

has_thread_sanitizer() { # with OpenMP; the program is linked, as a header alone proves nothing
    local program
    program=$(mktemp)
    echo 'int main() { return 0; }' |
        clang++ -fsanitize=thread -fopenmp -x c++ - -o "$program" 2>/dev/null
    local status=$?
    rm -f "$program"
    return $status
}

what=${1:-}
required=() optional=()
look() {
    required=() optional=()
    if [ "$what" = thread ]; then
        has_thread_sanitizer || required=(clang libomp-dev libclang-rt-dev)
        return
    fi
    has_cxx || required+=(g++)
    command -v cmake >/dev/null || required+=(cmake)
    command -v ninja >/dev/null || required+=(ninja-build)
    has_embree || required+=(libembree-dev)
    has_python_headers || required+=(python3-dev)
    has_venv || required+=(python3-venv)
    has_header doctest/doctest.h || optional+=(doctest-dev)
    has_header benchmark/benchmark.h || optional+=(libbenchmark-dev)
    command -v ccache >/dev/null || optional+=(ccache)
    has_browser || optional+=(chromium)
}

look
if [ $((${#required[@]} + ${#optional[@]})) -eq 0 ]; then
    exit 0
fi

as_root=()
if [ "$(id -u)" -ne 0 ]; then
    as_root=(sudo -n)
fi
if command -v apt-get >/dev/null && { [ "$(id -u)" -eq 0 ] || sudo -n true 2>/dev/null; }; then
    echo "installing system packages: ${required[*]} ${optional[*]}"
    log=$(mktemp)
    # An unreachable mirror must not stop a machine that already has the package in its cache.
    "${as_root[@]}" apt-get update >"$log" 2>&1 || tail -n 5 "$log" >&2
    # One by one: a package that the mirror lacks must not keep the others out.
    for package in "${required[@]}" "${optional[@]}"; do
        "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
            apt-get install -y --no-install-recommends "$package" >"$log" 2>&1 ||
            { echo "apt-get could not install $package:" >&2 && tail -n 5 "$log" >&2; }
    done
    rm -f "$log"
    look
fi

if [ ${#optional[@]} -gt 0 ]; then
    echo "missing: ${optional[*]} (C++ tests, benchmarks or tests of the report in a browser will be left out, or a second build takes as long as the first)" >&2
fi
if [ ${#required[@]} -gt 0 ]; then
    echo "missing: ${required[*]}; install them (Debian, Ubuntu: apt-get install" \
        "${required[*]}; conda: embree, cxx-compiler, cmake, ninja) and run make again" >&2
    exit 1
fi
