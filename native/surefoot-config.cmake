# find_package(surefoot) with surefoot_DIR from `python -m surefoot.native --cmakedir`: the target surefoot::surefoot has
# the folder of all headers, and surefoot_calibration_SOURCE is what has the table of their records' fields. NaN means
# that no reading arrived: never -ffast-math.
if(NOT TARGET surefoot::surefoot)
  add_library(surefoot::surefoot INTERFACE IMPORTED)
  set_target_properties(surefoot::surefoot PROPERTIES
    INTERFACE_INCLUDE_DIRECTORIES "${CMAKE_CURRENT_LIST_DIR}"
    INTERFACE_COMPILE_OPTIONS $<$<NOT:$<CXX_COMPILER_ID:MSVC>>:-ffp-contract=off>)
  foreach(_surefoot_package calibration envs sensors)
    set(surefoot_${_surefoot_package}_SOURCE "${CMAKE_CURRENT_LIST_DIR}/${_surefoot_package}.c")
  endforeach()
endif()
set(surefoot_FOUND TRUE)
