#!/usr/bin/env bash
# Makes a fresh clone ready: Debian packages, .venv with the host tools, for firmware on an emulated board a compiler and
# the emulator, and for the tests Ceedling in .gems.
#
#   tests/support/setup.sh demo|board|tests
#
# As root it installs the packages that are missing; as a plain user it names them all in one line and exits with 1.
# Does nothing, quickly, when nothing changed since it last ran.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
cd "$root"
python=/usr/bin/python3
ceedling=$(awk '/:ceedling_version:/ { print $2 }' project.yml)
log=build/setup.log
mkdir -p build
if command -v flock >/dev/null; then # two commands at once would install over each other
    exec 9>build/setup.lock
    flock 9
fi

say() { echo "set-up: $*"; }
step() { # step WHAT COMMAND...: its output goes to the log, and to the terminal if it fails
    say "$1"
    "${@:2}" >"$log" 2>&1 && return
    { grep -m 10 -E 'error:|ERROR|^E: ' "$log" || :; echo ...; tail -n 15 "$log"; } | sed 's/^/    /' >&2
    say "failed, whole output in $log: $1" >&2
    exit 1
}

# What has to be there: the Debian package, and how to tell that it or its like is there.
#   command   the shell finds it      header   gcc finds it, or the compiler after its name
#   module    /usr/bin/python3 does   runtime  clang does
#   file      it is there            library  the linker finds it
# With NumPy alone comes a BLAS that multiplies matrices twenty times as slowly as libopenblas.
needs='    gcc                 command  gcc
    libc6-dev           header   stdio.h
    make                command  make
    cmake               command  cmake
    python3             command  /usr/bin/python3
    python3-dev         header   Python.h
    python3-pip         module   pip
    python3-setuptools  module   setuptools
    python3-wheel       module   wheel
    python3-numpy       module   numpy
    python3-scipy       module   scipy
    libopenblas0-pthread  library  libopenblas.so.0
    python3-matplotlib  module   matplotlib
    python3-cffi        module   cffi
    python3-click       module   click
    python3-rich        module   rich
    python3-serial      module   serial
    python3-jinja2      module   jinja2'
board='
    gcc-arm-none-eabi   command  arm-none-eabi-gcc
    libnewlib-arm-none-eabi  header  math.h arm-none-eabi-gcc
    qemu-system-arm     command  qemu-system-arm'
case ${1-} in
demo) ;;
board) needs+=$board ;;
tests)
    # gcc-multilib excludes compilers for other machines; what is behind it does not.
    gcc=$(gcc -dumpversion 2>/dev/null || awk -F. '{ print $1 < 13 ? 12 : 14 }' /etc/debian_version 2>/dev/null || echo 14)
    needs+="$board
    gcc-${gcc%%.*}-multilib  header   stdio.h gcc -m32"'
    ccache              command  ccache
    g++                 command  g++
    clang               command  clang
    libclang-rt-dev     runtime  fuzzer
    clang-tidy          command  clang-tidy
    cppcheck            command  cppcheck
    libz3-dev           header   z3++.h g++ -x c++
    doxygen             command  doxygen
    gcc-riscv64-unknown-elf  command  riscv64-unknown-elf-gcc
    picolibc-riscv64-unknown-elf  header  stdio.h riscv64-unknown-elf-gcc --specs=picolibc.specs
    qemu-system-misc    command  qemu-system-riscv32
    qemu-user           command  qemu-i386
    gcc-s390x-linux-gnu  command  s390x-linux-gnu-gcc
    libc6-dev-s390x-cross  header  stdio.h s390x-linux-gnu-gcc
    gcc-avr             command  avr-gcc
    avr-libc            header   avr/io.h avr-gcc
    arduino-core-avr    file     /usr/share/arduino/hardware/arduino/avr/boards.txt
    arduino-builder     command  arduino-builder
    simavr              command  simavr
    pkgconf             command  pkg-config
    ruby                command  ruby
    chromium-driver     command  chromedriver
    python3-sphinx      module   sphinx
    python3-myst-parser  module   myst_parser
    python3-breathe     module   breathe
    furo                module   furo
    python3-pytest      module   pytest
    python3-pytest-xdist  module  xdist
    python3-hypothesis  module   hypothesis
    python3-distributed  module   distributed
    python3-jsonschema  module   jsonschema
    python3-selenium    module   selenium
    python3-nbclient    module   nbclient
    python3-ipykernel   module   ipykernel
    xvfb                command  xvfb-run
    xauth               command  xauth
    python3-tk          module   tkinter'
    ;;
*)
    sed -n '2,8s/^# \{0,1\}//p' "$0" >&2
    exit 2
    ;;
esac

missing() { # the packages to install, on one line
    local package kind name compiler include='' modules='' packages=()
    if [ -x $python ]; then
        { read -r include && read -r modules; } < <($python - $(awk '$2 == "module" { print $3 }' <<<"$needs") <<'PY'
import sys, sysconfig
from importlib.util import find_spec
print(sysconfig.get_path("include"))
print(*(name for name in sys.argv[1:] if find_spec(name)))
PY
        )
    fi
    while read -r package kind name compiler; do
        case $kind in
        command) command -v "$name" ;;
        # shellcheck disable=SC2086 # with its options
        header) echo "#include <$name>" | ${compiler:-gcc -I "${include:-.}"} -E - ;;
        runtime) [ -e "$(clang -print-file-name="lib/linux/libclang_rt.$name-$(uname -m).a")" ] ;;
        file) [ -e "$name" ] ;;
        library) /sbin/ldconfig -p | grep -F "$name" ;; # to the end: -q would break the pipe, now and then
        module) [[ " $modules " == *" $name "* ]] ;;
        esac >/dev/null 2>&1 || packages+=("$package")
    done <<<"$needs"
    echo "${packages[*]}"
}

packages=$(missing)
if [ -n "$packages" ] && ! command -v apt-get >/dev/null; then
    say "missing, by their Debian names: $packages" >&2
    exit 1
elif [ -n "$packages" ] && [ "$(id -u)" != 0 ]; then
    say "packages are missing. Install them, then give this command again:" >&2
    echo "sudo apt-get update && sudo apt-get install $packages" >&2
    exit 1
elif [ -n "$packages" ]; then
    apt=(env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300)
    step "reading the package lists" "${apt[@]}" update
    # shellcheck disable=SC2086 # one word per package
    step "installing $packages" "${apt[@]}" install -y --no-install-recommends $packages
    packages=$(missing)
    [ -z "$packages" ] || { say "still missing after apt-get install: $packages" >&2; exit 1; }
fi

# .venv belongs to one place and one Python; the host tools in it, to one state of what they are built from.
place="$root $($python -VV | tr '\n' ' ')"
sources=$(find CMakeLists.txt lib host_tools/{pyproject.toml,setup.py,firmware_build.py,firmware} -type f -print0 |
    sort -z | xargs -0 sha256sum | sha256sum)
stamp=.venv/made-from
if [ ! -x .venv/bin/python ] || [ "$(head -n 1 $stamp 2>/dev/null)" != "$place" ]; then
    # CMake refuses a cache that was made elsewhere: the checkout has been moved.
    find build -name CMakeCache.txt ! -exec grep -qF "CMAKE_CACHEFILE_DIR:INTERNAL=$root/" {} \; -delete
    # Debian's own pip serves inside it too.
    step "creating .venv" $python -m venv --clear --without-pip --system-site-packages .venv
fi
if [ ! -x .venv/bin/rdpi ] || [ "$(cat $stamp 2>/dev/null)" != "$place"$'\n'"$sources" ]; then
    step "building the host tools" env PIP_CONFIG_FILE=/dev/null .venv/bin/python -m pip --isolated \
        --disable-pip-version-check install --no-index --no-deps --no-build-isolation --no-cache-dir --editable host_tools
    printf '%s\n' "$place" "$sources" >$stamp
fi

if [ "$1" = tests ] && [ ! -f .gems/specifications/ceedling-$ceedling.gemspec ]; then
    rm -rf .gems
    step "installing Ceedling $ceedling" env GEM_HOME="$root/.gems" GEM_PATH="$root/.gems" \
        gem install --norc --no-document --install-dir .gems --bindir .gems/bin ceedling:$ceedling
fi
