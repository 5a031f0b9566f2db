# The target `flash`: writes the application to the board and starts it, through a debug probe. A port that has it names
# its chip by the properties RDPI_OPENOCD (a configuration file of OpenOCD), RDPI_PYOCD (a target of pyOCD) and
# RDPI_FLASH_ORIGIN.
set(RDPI_FLASHER "" CACHE STRING "Programmer: openocd, pyocd or st-flash, name or path; empty: the first installed")
set(RDPI_PROBE interface/stlink.cfg CACHE STRING "OpenOCD's configuration file for the debug probe")

# rdpi_flash(APPLICATION): what `flash` writes; of several applications the last.
function(rdpi_flash application)
  foreach(property RDPI_OPENOCD RDPI_PYOCD RDPI_FLASH_ORIGIN)
    get_target_property(${property} rdpi_port_${RDPI_PORT} ${property})
  endforeach()
  if(NOT RDPI_OPENOCD)
    if(NOT TARGET flash)
      add_custom_target(flash COMMAND "${CMAKE_COMMAND}" -E echo "port/${RDPI_PORT} names no chip to flash"
        COMMAND "${CMAKE_COMMAND}" -E false VERBATIM)
    endif()
    return()
  endif()
  if(TARGET flash)
    set_target_properties(flash PROPERTIES RDPI_APPLICATION ${application})
    return()
  endif()

  set(names openocd pyocd st-flash)
  if(RDPI_FLASHER)
    set(names "${RDPI_FLASHER}")
  endif()
  find_program(program NAMES ${names} NO_CACHE)
  cmake_path(GET program STEM name)
  set(image "$<TARGET_FILE:$<TARGET_PROPERTY:flash,RDPI_APPLICATION>>")
  if(NOT program)
    list(JOIN names ", " names)
    set(command "${CMAKE_COMMAND}" -E echo
      "No ${names}: install openocd, python3-pyocd or stlink-tools, then cmake ${PROJECT_BINARY_DIR} and again"
      COMMAND "${CMAKE_COMMAND}" -E false)
  elseif(name STREQUAL "openocd")
    set(command "${program}" -f "${RDPI_PROBE}" -f "${RDPI_OPENOCD}" -c "program {${image}} verify reset exit")
  elseif(name STREQUAL "pyocd")
    set(command "${program}" flash --target "${RDPI_PYOCD}" --format elf "${image}")
  elseif(name STREQUAL "st-flash")
    set(command "${CMAKE_OBJCOPY}" -O binary "${image}" "${image}.bin"
      COMMAND "${program}" --reset write "${image}.bin" "${RDPI_FLASH_ORIGIN}")
  else()
    message(FATAL_ERROR "RDPI_FLASHER is ${RDPI_FLASHER}; openocd, pyocd and st-flash are known")
  endif()
  add_custom_target(flash COMMAND ${command} DEPENDS "$<TARGET_PROPERTY:flash,RDPI_APPLICATION>" USES_TERMINAL VERBATIM)
  set_target_properties(flash PROPERTIES RDPI_APPLICATION ${application})
endfunction()
