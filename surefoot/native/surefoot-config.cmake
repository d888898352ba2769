# find_package(surefoot) with surefoot_DIR from `python -m surefoot.native --cmakedir`: the target surefoot::surefoot has
# the folders of all headers, and surefoot_calibration_SOURCE is what has the table of their records' fields. NaN means
# that no reading arrived: never -ffast-math.
if(NOT TARGET surefoot::surefoot)
  add_library(surefoot::surefoot INTERFACE IMPORTED)
  get_filename_component(_surefoot_packages "${CMAKE_CURRENT_LIST_DIR}/.." REALPATH)
  # Packages lie in the package of a wheel, and beside it in a checkout.
  foreach(_surefoot_package calibration envs sensors)
    foreach(_surefoot_root "${_surefoot_packages}" "${_surefoot_packages}/..")
      if(EXISTS "${_surefoot_root}/${_surefoot_package}/native/library.c")
        set_property(TARGET surefoot::surefoot APPEND PROPERTY
          INTERFACE_INCLUDE_DIRECTORIES "${_surefoot_root}/${_surefoot_package}/native")
        set(surefoot_${_surefoot_package}_SOURCE "${_surefoot_root}/${_surefoot_package}/native/library.c")
        break()
      endif()
    endforeach()
  endforeach()
  set_property(TARGET surefoot::surefoot APPEND PROPERTY
    INTERFACE_INCLUDE_DIRECTORIES "${CMAKE_CURRENT_LIST_DIR}")
  set_property(TARGET surefoot::surefoot PROPERTY INTERFACE_COMPILE_OPTIONS
    $<$<NOT:$<CXX_COMPILER_ID:MSVC>>:-ffp-contract=off>)
endif()
set(surefoot_FOUND TRUE)
