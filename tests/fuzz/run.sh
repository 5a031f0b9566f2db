#!/usr/bin/env bash
# Fuzzes the library and port/drivers with libFuzzer and the address and undefined-behaviour sanitizers.
#
#   tests/fuzz/run.sh SECONDS [TARGET...]    each target (any_f32, ...) for that long, all at once
#
# Starts from corpus/TARGET, which also keeps inputs that once found something. What is found stays in build/fuzz:
# build/fuzz/TARGET FILE shows it again.
set -uo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
cd "$root" || exit
if ! [[ ${1-} =~ ^[0-9]+$ ]]; then
    sed -n '2,7s/^# \{0,1\}//p' "$0" >&2
    exit 2
fi
seconds=$1
shift
targets=("$@")
[ $# -gt 0 ] || for file in tests/fuzz/*.c; do targets+=("$(basename "$file" .c)"); done
work=build/fuzz
mkdir -p $work

fuzz() {
    local target=$1
    rm -rf "$work/$target-new"
    mkdir "$work/$target-new" || return
    clang -std=c11 -g -O1 -Wall -Wextra -fno-omit-frame-pointer -fno-sanitize-recover=all \
        -fsanitize=fuzzer,address,undefined,float-cast-overflow \
        -Ilib/include -Itests/support -Iport/include "tests/fuzz/$target.c" lib/src/*.c -lm -o "$work/$target" &&
        "$work/$target" -max_total_time="$seconds" -max_len=2048 -timeout=10 -use_value_profile=1 -print_final_stats=1 \
            -artifact_prefix="$work/$target-" "$work/$target-new" "tests/fuzz/corpus/$target"
}

declare -A jobs
for target in "${targets[@]}"; do
    fuzz "$target" >"$work/$target.log" 2>&1 </dev/null &
    jobs[$target]=$!
done
passed=0 failed=0
for target in "${targets[@]}"; do
    if ! wait "${jobs[$target]}"; then
        { grep -E 'error:|ERROR: ' "$work/$target.log" | head -n 5; tail -n 5 "$work/$target.log"; } | sed 's/^/    /'
        echo "$target: failed, see $work/$target.log"
        failed=$((failed + 1))
    elif [[ $target == any_* ]] && ! grep -q '^accepted: [1-9]' "$work/$target.log"; then
        echo "$target: failed: init has accepted no input; mend tests/fuzz/seeds.py"
        failed=$((failed + 1))
    else
        echo "$target: $(awk '/number_of_executed_units/ { print $2 }' "$work/$target.log") inputs"
        passed=$((passed + 1))
    fi
done
echo "fuzz: $passed passed, $failed failed"
[ $failed = 0 ]
