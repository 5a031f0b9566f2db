# Cross-compiles with Debian's s390x-linux-gnu-gcc for a big-endian core; tests run in qemu-s390x. (Debian's PowerPC
# would be nearer to a microcontroller, but its libm holds an instruction that qemu-ppc does not know.)
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR s390x)
set(CMAKE_C_COMPILER s390x-linux-gnu-gcc)
set(CMAKE_CROSSCOMPILING_EMULATOR qemu-s390x)
set(CMAKE_EXE_LINKER_FLAGS_INIT -static) # or qemu would look for its shared libraries
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_C_FLAGS_INIT -fexcess-precision=fast) # with -std=c99 it would compute float in double, as no microcontroller does
