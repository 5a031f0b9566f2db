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

if cc -std=c99 -O2 -ffast-math -Iinclude -c src/rdpi_f32.c -o "$copy/object.o" 2>"$copy/refusal" ||
    ! grep -q 'compile it without -ffast-math' "$copy/refusal"; then
    echo "lib_alone: -ffast-math, which drops the checks for NaN, is not refused" >&2
    exit 1
fi
