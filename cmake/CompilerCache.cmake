# ccache, where it is: the wheel of `make dist-check` compiles what `make setup` has compiled.
# Elsewhere name another launcher or none: -DCMAKE_CXX_COMPILER_LAUNCHER=
if(NOT DEFINED CMAKE_CXX_COMPILER_LAUNCHER)
  find_program(GERAF2_CCACHE ccache)
  if(GERAF2_CCACHE)
    # Sources are known by their path as seen from the build folder, so that two copies of the
    # project share objects. Of the bindings only those under cpp/: pybind11 keeps its full path,
    # which is the same for both, whether or not its environment lies inside a copy.
    set(geraf2_launcher ${CMAKE_COMMAND} -E env CCACHE_NOHASHDIR=1)
    set(geraf2_bindings_launcher
      ${geraf2_launcher} CCACHE_BASEDIR=${PROJECT_SOURCE_DIR}/cpp ${GERAF2_CCACHE})
    list(APPEND geraf2_launcher CCACHE_BASEDIR=${PROJECT_SOURCE_DIR} ${GERAF2_CCACHE})
    # Where ccache may not write its folder, it ends with an error instead of compiling.
    execute_process(
      COMMAND ${geraf2_launcher} ${CMAKE_CXX_COMPILER} -x c++ -c /dev/null
        -o ${PROJECT_BINARY_DIR}/ccache_probe.o
      RESULT_VARIABLE geraf2_ccache_fails
      OUTPUT_QUIET ERROR_QUIET)
    if(NOT geraf2_ccache_fails)
      set(CMAKE_CXX_COMPILER_LAUNCHER ${geraf2_launcher})
    else()
      unset(geraf2_bindings_launcher)
    endif()
  endif()
endif()
