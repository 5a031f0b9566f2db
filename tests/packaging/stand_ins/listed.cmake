# listed(SOURCES INCLUDES MACROS): writes what a manifest has told, for ../test_manifests.py.
function(listed sources includes macros)
  file(WRITE "${CMAKE_BINARY_DIR}/listed.txt" "sources=${sources}\nincludes=${includes}\nmacros=${macros}\n")
endfunction()
