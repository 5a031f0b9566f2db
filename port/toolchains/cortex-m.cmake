# Cross-compiles with arm-none-eabi-gcc. RDPI_CPU holds the flags that choose the core, RDPI_MACHINE the board that
# qemu-system-arm runs tests on; the presets set both.
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR arm)
if(NOT RDPI_CPU MATCHES "-mcpu=")
  message(FATAL_ERROR "RDPI_CPU is '${RDPI_CPU}' and names no core: give the compiler's flags for yours, e.g. "
                      "-DRDPI_CPU=-mcpu=cortex-m0plus, or take a preset that does")
endif()
find_program(RDPI_ARM_GCC arm-none-eabi-gcc)
if(NOT RDPI_ARM_GCC)
  message(FATAL_ERROR "No arm-none-eabi-gcc: apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi")
endif()
set(CMAKE_C_COMPILER "${RDPI_ARM_GCC}")
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY) # no board yet, so nothing to link a program with
set(CMAKE_TRY_COMPILE_PLATFORM_VARIABLES RDPI_CPU)
set(CMAKE_CROSSCOMPILING_EMULATOR
  qemu-system-arm -M ${RDPI_MACHINE} -nographic -monitor none -serial none -semihosting -kernel)
set(CMAKE_C_FLAGS_INIT "${RDPI_CPU} -mthumb -ffunction-sections -fdata-sections")
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
