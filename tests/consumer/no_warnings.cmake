# cmake -DCOMMANDS=compile_commands.json -P: rdpi switches no warning on in another project's build, where each could be
# an error.
file(STRINGS "${COMMANDS}" commands REGEX "\"command\":")
set(ours "${commands}")
list(FILTER ours INCLUDE REGEX "/(lib|port|examples)/[a-z0-9_/]+[.]c\"")
list(LENGTH ours count)
if(count LESS 4)
  message(FATAL_ERROR "${COMMANDS} compiles ${count} files of the library, port and example")
endif()
foreach(command IN LISTS commands)
  string(REGEX MATCH " -W[^ ]*" warning "${command}")
  if(warning AND NOT warning STREQUAL " -Werror=overflow") # of a header that the host tools make
    message(FATAL_ERROR "${warning} in ${command}")
  endif()
endforeach()
