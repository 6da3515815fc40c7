# OpenMP, Embree 4 (else 3), and pybind11 when the Python extension is built.
find_package(OpenMP REQUIRED COMPONENTS CXX)

find_package(embree 4 CONFIG QUIET)
if(NOT embree_FOUND)
  find_package(embree 3 CONFIG QUIET)
endif()
if(NOT embree_FOUND)
  message(FATAL_ERROR
    "geraf2 needs the Embree ray tracer, version 4 or 3.13, and CMake did not find it.\n"
    "  Debian, Ubuntu:  apt-get install libembree-dev\n"
    "  conda:           conda install -c conda-forge embree\n"
    "  elsewhere:       pass -Dembree_DIR=<folder that holds embree-config.cmake>")
endif()
message(STATUS "Embree ${embree_VERSION}")

if(GERAF2_BUILD_PYTHON)
  find_package(Python 3.11 REQUIRED COMPONENTS Interpreter Development.Module)
  find_package(pybind11 CONFIG REQUIRED)
endif()
