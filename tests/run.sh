#!/usr/bin/env bash
# Every test: C under CTest and Ceedling, Python under pytest. Installs what is missing first.
#
#   ./tests/run.sh           all that a change can break, as CI does: also sanitizers, coverage, emulators, slow tests
#   ./tests/run.sh --quick   CTest and the fast pytests
#   ./tests/run.sh --long    everything: also mutation, instruction counts, withheld cases, all proofs
#
# All runners run even when one fails; their own closing lines come last, whole outputs are in build/logs.
set -uo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root" || exit
case "$*" in
'' | --quick | --long) level=${1-} ;;
*)
    sed -n '2,9s/^# \{0,1\}//p' "$0" >&2
    exit 2
    ;;
esac
long=${level#--quick}
unset PYTHONUNBUFFERED # as users have it: what a program leaves in its buffers counts
export OPENBLAS_NUM_THREADS=1 # there is a pytest per core already
# Tests build the library dozens of times, mostly with the same flags in another folder.
export CMAKE_C_COMPILER_LAUNCHER=ccache CCACHE_DIR=$root/build/ccache CCACHE_NOHASHDIR=1
tests/support/setup.sh tests || exit

logs=build/logs
rm -rf $logs
mkdir -p $logs
closing=()
failed=()
run() { # run NAME PATTERN COMMAND...: PATTERN picks the runner's closing lines out of its output
    local name=$1 pattern=$2 log=$logs/$1.log begin=$SECONDS status=passed processor TIMEFORMAT='%U %S'
    shift 2
    if ! processor=$({ time "$@" >"$log" 2>&1 </dev/null; } 2>&1); then
        status=failed
        failed+=("$name")
        { grep -E '^FAIL|:FAIL|error:|^E  |ERROR:' "$log" | head -n 20; echo ...; tail -n 20 "$log"; } | sed 's/^/    /'
    fi
    echo "$name: $status in $((SECONDS - begin)) s, of the processors $(awk '{ printf "%.0f", $1 + $2 }' <<<"$processor") s"
    closing+=("$(grep -E "$pattern" "$log" | tail -n 4)")
}
ctest_preset() {
    cmake --preset "$1" "-DRDPI_LONG=${long:+ON}" && cmake --build --preset "$1" --parallel "$(nproc)" &&
        ctest --preset "$1" --parallel "$(nproc)" --output-junit ctest.xml
}
names() {
    .venv/bin/python tests/ceedling/compare_names.py build/host/ctest.xml build/ceedling/artifacts/test/tests_report.json
}
pytests() {
    local folder folders=()
    # A file keeps one core busy: the longest first and many short ones last, so that all cores end together. One more
    # than there are cores: emulators and browsers are waited for.
    for folder in tests/{withheld,replay}/ tests/*/ host_tools/tests/; do
        compgen -G "$folder/test_*.py" >/dev/null && [[ " ${folders[*]} " != *" $folder "* ]] && folders+=("$folder")
    done
    .venv/bin/python -m pytest -c host_tools/pyproject.toml --rootdir . -n $(($(nproc) + 1)) --dist loadfile "$@" "${folders[@]}"
}

rm -rf build/host/ctest.xml build/ceedling/artifacts # same-names must not read those of an earlier run
ctest_lines='tests passed, .* tests? failed out of|^No tests were found'
run ctest-host "$ctest_lines" ctest_preset host
if [ "$level" != --quick ]; then
    run ctest-sanitize "$ctest_lines" ctest_preset sanitize
    run ctest-coverage "$ctest_lines" ctest_preset coverage
    run ceedling '^(TESTED|PASSED|FAILED|IGNORED): ' env GEM_HOME="$root/.gems" GEM_PATH="$root/.gems" .gems/bin/ceedling test:all
    run same-names 'executed' names
    for core in m0plus ${long:+m3} m4f ${long:+m7} rv32 s390x; do # the least, the usual, no Cortex, and big-endian
        run ctest-$core "$ctest_lines" ctest_preset $core
    done
    run same-bits '^same-bits: ' tests/emulator/same_bits.sh
    run lint '^lint: ' tests/lint/lint.py
    run proof '^proof: ' tests/proof/run.py ${long:+--long}
    run size '^size: ' tests/size/size.py --check lib/README.md
    fuzz_seconds=5
    [ "$long" ] && fuzz_seconds=60
    run fuzz '^fuzz: ' tests/fuzz/run.sh $fuzz_seconds
fi
if [ "$long" ]; then
    run instructions '^instructions: ' .venv/bin/python tests/benchmark/instructions.py --check lib/README.md
    run mutation '^mutation: ' tests/mutation/mutate.py
fi
declare -A tests=([--quick]='not slow and not long' [normal]='not long' [--long]='')
run pytest ' in [0-9.]+s' pytests -m "${tests[${level:-normal}]}" --durations 30

echo
printf '%s\n' "${closing[@]}" | grep .
if [ ${#failed[@]} -gt 0 ]; then
    echo "failed: ${failed[*]} (outputs in $logs)"
    exit 1
fi
