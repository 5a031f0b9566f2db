#!/usr/bin/env bash
# lib/ copied into someone's tree: it compiles there with strict warnings, and every header stands alone in C and C++.
set -euo pipefail
lib=$(cd "$(dirname "$0")/../../lib" && pwd)
copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
cp -r "$lib" "$copy"
cd "$copy/lib"

strict=(-Wall -Wextra -Wconversion -Wshadow -Wpedantic -Werror -Iinclude)
for source in src/*.c; do
    cc -std=c99 "${strict[@]}" -c "$source" -o "$copy/object.o"
done
for header in include/rdpi/*.h; do
    echo "#include \"${header#include/}\"" >"$copy/alone.c"
    cc -x c -std=c99 "${strict[@]}" -fsyntax-only "$copy/alone.c"
    c++ -x c++ -std=c++11 "${strict[@]}" -fsyntax-only "$copy/alone.c"
done

# Options that drop the checks for NaN or take sums for associative: refused, or they change nothing. gcc from 12 on says
# which it was given; clang says so of -ffast-math alone, and otherwise makes the same code.
code() { # code COMPILER OPTION... SOURCE: of its functions
    "$1" -std=c99 -O2 -Iinclude "${@:2}" -c -o "$copy/object.o" 2>"$copy/refusal" && objdump -d "$copy/object.o" | tail -n +4
}
unsafe=(-ffast-math -ffinite-math-only -funsafe-math-optimizations -freciprocal-math
    '-fassociative-math -fno-signed-zeros -fno-trapping-math' '-ffast-math -fno-finite-math-only')
for source in src/rdpi_f32.c src/rdpi_f32_chain.c; do
    for compiler in gcc clang; do
        as_written=$(code $compiler $source)
        contracted=$(code $compiler -ffp-contract=fast $source) # the last of the options also asks for that
        for options in "${unsafe[@]}"; do
            # shellcheck disable=SC2086 # several options
            if found=$(code $compiler $options $source); then
                [ $compiler = clang ] && { [ "$found" = "$as_written" ] || [ "$found" = "$contracted" ]; } && continue
            elif grep -q 'compile it without -f' "$copy/refusal"; then
                continue
            fi
            echo "lib_alone: $compiler $options changes $source, and is not refused" >&2
            exit 1
        done
    done
done
