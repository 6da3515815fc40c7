# OpenMP, Embree 4 (else 3), pybind11 when the Python extension is built, doctest and Google
# Benchmark when asked for. A missing package stops here, with what to install.
find_package(OpenMP COMPONENTS CXX)
if(NOT OpenMP_CXX_FOUND)
  message(FATAL_ERROR
    "geraf2 needs a C++ compiler with OpenMP, and ${CMAKE_CXX_COMPILER} has none.\n"
    "  Debian, Ubuntu:  apt-get install g++   (or libomp-dev for clang++)")
endif()

if(GERAF2_EMBREE)
  find_package(embree 4 CONFIG QUIET)
  if(NOT embree_FOUND)
    find_package(embree 3 CONFIG QUIET)
  endif()
  if(embree_FOUND)
    message(STATUS "Embree ${embree_VERSION}")
  endif()
elseif(GERAF2_BUILD_PYTHON)
  message(FATAL_ERROR "The Python extension needs Embree: GERAF2_EMBREE=OFF is for the C++ tests")
endif()
if(GERAF2_EMBREE AND NOT embree_FOUND)
  message(FATAL_ERROR
    "geraf2 needs the Embree ray tracer, version 4 or 3.13, and CMake did not find it.\n"
    "  Debian, Ubuntu:  apt-get install libembree-dev\n"
    "  conda:           conda install -c conda-forge embree\n"
    "  elsewhere:       pass -Dembree_DIR=<folder that holds embree-config.cmake>")
endif()

if(GERAF2_BUILD_PYTHON)
  find_package(Python 3.11 REQUIRED COMPONENTS Interpreter Development.Module)
  # scikit-build-core names the folder by itself; a plain CMake call asks the interpreter.
  if(NOT pybind11_DIR)
    execute_process(
      COMMAND ${Python_EXECUTABLE} -m pybind11 --cmakedir
      OUTPUT_VARIABLE geraf2_pybind11_dir
      OUTPUT_STRIP_TRAILING_WHITESPACE
      ERROR_QUIET)
    if(geraf2_pybind11_dir)
      set(pybind11_DIR "${geraf2_pybind11_dir}" CACHE PATH "Folder of pybind11Config.cmake")
    endif()
  endif()
  find_package(pybind11 2.13 CONFIG QUIET)
  if(NOT pybind11_FOUND)
    message(FATAL_ERROR
      "geraf2 needs pybind11 2.13 or newer to build its Python extension.\n"
      "  ${Python_EXECUTABLE} -m pip install 'pybind11>=2.13'\n"
      "  or build the kernels alone: -DGERAF2_BUILD_PYTHON=OFF")
  endif()
endif()

if(GERAF2_BUILD_TESTS)
  find_package(doctest CONFIG QUIET)
  if(NOT doctest_FOUND)
    if(GERAF2_BUILD_TESTS STREQUAL "AUTO")
      message(STATUS "doctest not found: no C++ tests (Debian, Ubuntu: apt-get install doctest-dev)")
      set(GERAF2_BUILD_TESTS OFF)
    else()
      message(FATAL_ERROR
        "The C++ tests need doctest.\n"
        "  Debian, Ubuntu:  apt-get install doctest-dev\n"
        "  or leave them out: -DGERAF2_BUILD_TESTS=OFF")
    endif()
  endif()
endif()

if(GERAF2_BUILD_BENCH)
  find_package(benchmark CONFIG QUIET)
  if(NOT benchmark_FOUND)
    if(GERAF2_BUILD_BENCH STREQUAL "AUTO")
      message(STATUS "Google Benchmark not found: no C++ benchmarks (libbenchmark-dev)")
      set(GERAF2_BUILD_BENCH OFF)
    else()
      message(FATAL_ERROR
        "The C++ benchmarks need Google Benchmark.\n"
        "  Debian, Ubuntu:  apt-get install libbenchmark-dev\n"
        "  or leave them out: -DGERAF2_BUILD_BENCH=OFF")
    endif()
  endif()
endif()
