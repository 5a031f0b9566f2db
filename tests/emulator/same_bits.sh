#!/usr/bin/env bash
# The fixed-point library gives the same bits whatever compiles and runs it: tests/property/fixed.c and chain_q31.c on
# this machine with both compilers, word sizes, and the portable paths, and on emulated Cortex-M, RISC-V and big-endian
# s390x, all with one checksum each.
set -uo pipefail
cd "$(dirname "$0")/../.." || exit
build=build/same_bits
mkdir -p $build
steps=200 # of 5000 per actuator: the emulated cores have no double-precision unit for the reference
library=(lib/src/rdpi_q31.c lib/src/rdpi_q31_chain.c lib/src/status.c)
common=(-std=gnu99 -DSTEPS=$steps -DHOURS=0.0005 -Ilib/include -Ilib/src -Itests/support)
names=()
passed=0
failed=0

start() { # start NAME COMMAND...: builds and runs a program, beside others as there are cores
    while [ "$(jobs -pr | wc -l)" -ge "$(nproc)" ]; do wait -n; done
    built=$build/${#names[@]}
    names+=("$1")
    "${@:2}" >"$built.txt" 2>&1 &
}
compare() { # of all that were started since
    local output checksum expected= k
    wait
    for k in "${!names[@]}"; do
        output=$(<"$build/$k.txt")
        checksum=$(sed -n 's/^checksum of all results: //p' <<<"$output")
        expected=${expected:-$checksum}
        if [ -n "$checksum" ] && [ "$checksum" = "$expected" ]; then
            passed=$((passed + 1))
        else
            failed=$((failed + 1))
            printf '%s\n' "$output"
        fi
        printf '%-44s %s\n' "${names[k]}" "${checksum:-no checksum}"
    done
    names=()
}

host() { # host COMPILER FLAGS...
    "$@" "${common[@]}" "${sources[@]}" -lm -o "$built" || return
    "$built" || { [ $? = 126 ] && qemu-i386 "$built"; } # 126: the kernel runs no 32-bit programs
}

core() { # core MACHINE FLASH RAM FLAGS...
    local machine=$1 flash=$2 ram=$3
    shift 3
    arm-none-eabi-gcc -mthumb "$@" "${common[@]}" --specs=rdimon.specs -nostartfiles -T port/cortex_m/cortex_m.ld \
        -Wl,--defsym=flash_size="$flash" -Wl,--defsym=ram_size="$ram" -ffunction-sections -Wl,--gc-sections \
        tests/emulator/board.c "${sources[@]}" -lm -o "$built" &&
        timeout 300 qemu-system-arm -M "$machine" -nographic -monitor none -serial none -semihosting \
            -kernel "$built"
}

rv32() { # rv32 FLAGS...
    riscv64-unknown-elf-gcc -march=rv32imac -mabi=ilp32 -misa-spec=2.2 --specs=picolibc.specs "$@" "${common[@]}" \
        --oslib=semihost --crt0=hosted -Wl,--defsym=__flash=0x80000000 -Wl,--defsym=__flash_size=4M \
        -Wl,--defsym=__ram=0x80400000 -Wl,--defsym=__ram_size=4M "${sources[@]}" -lm -o "$built" &&
        timeout 300 qemu-system-riscv32 -M virt -bios none -nographic -monitor none -serial none -semihosting \
            -kernel "$built" # stderr is its console
}

s390x() { # s390x FLAGS...
    s390x-linux-gnu-gcc -static "$@" "${common[@]}" "${sources[@]}" -lm -o "$built" && timeout 300 qemu-s390x "$built"
}

for program in fixed chain_q31; do
    sources=(tests/property/$program.c "${library[@]}")
    for compiler in gcc clang; do
        for flags in "-m64 -O2" "-m32 -O2" "-m64 -O0" "-m32 -Os" "-m64 -O3 -flto" "-m64 -O2 -DRDPI_Q31_PORTABLE"; do
            # shellcheck disable=SC2086 # several flags
            start "$program $compiler $flags" host $compiler $flags
        done
    done
    # Code for the M0 runs on the M3's machine as well, which has memory for the reference's history.
    start "$program Cortex-M0 -Os" core mps2-an385 4M 4M -mcpu=cortex-m0 -Os
    start "$program Cortex-M3 -O2" core mps2-an385 4M 4M -mcpu=cortex-m3 -O2
    start "$program Cortex-M4F -O2" core mps2-an386 4M 4M -mcpu=cortex-m4 -mfpu=fpv4-sp-d16 -mfloat-abi=hard -O2
    start "$program Cortex-M7 -O2" core mps2-an500 4M 4M -mcpu=cortex-m7 -mfpu=fpv5-d16 -mfloat-abi=hard -O2
    start "$program RV32IMAC -O2" rv32 -O2
    for flags in -O2 -O0; do
        start "$program s390x, big-endian, $flags" s390x $flags
    done
    compare
done
echo "same-bits: $passed passed, $failed failed"
[ $failed = 0 ]
