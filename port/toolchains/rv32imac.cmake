# Cross-compiles with riscv64-unknown-elf-gcc and picolibc for RV32IMAC; tests run in qemu-system-riscv32's machine virt.
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR riscv32)
set(CMAKE_C_COMPILER riscv64-unknown-elf-gcc)
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY) # where memory is, only a program says
set(CMAKE_CROSSCOMPILING_EMULATOR
  qemu-system-riscv32 -M virt -bios none -nographic -monitor none -serial none -semihosting -kernel)
# The ISA specification is that of the multilibs; in later ones the CSR instructions are an extension of their own.
set(CMAKE_C_FLAGS_INIT
  "-march=rv32imac -mabi=ilp32 -misa-spec=2.2 --specs=picolibc.specs -ffunction-sections -fdata-sections")
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
