#!/usr/bin/env bash
# Every library of one setting, linked to an application of another, is found out by init before anything is written.
set -euo pipefail
root=$(cd "$(dirname "$0")/../.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
settings=(
    ""
    "-DRDPI_MAX_PLAYS=10 -DRDPI_MAX_WINDOW=1"
    "-DRDPI_MAX_PLAYS=10 -DRDPI_MAX_WINDOW=3" # states of this and the next are equally large
    "-DRDPI_MAX_PLAYS=12 -DRDPI_MAX_WINDOW=1"
    "-DRDPI_MAX_PLAYS=1 -DRDPI_MAX_WINDOW=4096"
    "-DRDPI_MAX_CURVE_PIECES=1"
    "-DRDPI_NOISE_SHAPING=0"
    "-fpack-struct -Wno-address-of-packed-member"
)

compile() { # compile FOLDER SETTING...: library and application
    local folder=$work/$1
    shift
    mkdir "$folder"
    for source in "$root"/lib/src/*.c "$root/tests/consumer/settings.c"; do
        cc -std=c99 -Wall -Wextra -Wpedantic -Werror -fsanitize=address -fno-sanitize-recover=all "$@" \
            -I"$root/lib/include" -c "$source" -o "$folder/$(basename "$source" .c).o"
    done
}
for s in "${!settings[@]}"; do
    # shellcheck disable=SC2086 # several flags
    compile "$s" ${settings[s]}
done
compile real -DRDPI_REAL=double
compile poles -DRDPI_MAX_POLES=3
compile pieces -DRDPI_MAX_CURVE_PIECES=3

pairs=0
check() { # check LIBRARY APPLICATION STATUS [same]
    local status=0
    cc -fsanitize=address "$work/$1"/{rdpi_f32,rdpi_f32_chain,rdpi_q31,status}.o "$work/$2/settings.o" -o "$work/program"
    "$work/program" ${4:+same} || status=$?
    if [ $status != "$3" ]; then
        echo "settings: library $1, application $2: exit status $status, not $3" >&2
        exit 1
    fi
    pairs=$((pairs + 1))
}
for library in "${!settings[@]}"; do
    for application in "${!settings[@]}"; do
        same=
        [ "$library" = "$application" ] && same=same
        check "$library" "$application" 0 $same
    done
done
check real real 0 same
# rdpi_q31 has no reals, so its application is right to expect the same library.
check 0 real 2
check real 0 2
# How many pieces there may be changes no layout, unless it is one.
check 0 pieces 0 same
check pieces 0 0 same
# Only the chain has poles.
check poles poles 0 same
check 0 poles 3
check poles 0 3
echo "settings: $pairs pairs of library and application"
