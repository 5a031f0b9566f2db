#!/usr/bin/env bash
# The site, of the README files and the sources: build/site/html/index.html. Every warning is an error.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
tests/support/setup.sh tests
rm -rf build/site
mkdir -p build/site
doxygen tests/site/Doxyfile
# Doxygen 1.9.8 gives an enum without a name an empty one, where 1.9.4 has @0, and Breathe needs that.
sed -i 's:<name></name>:<name>@0</name>:' build/site/doxygen/xml/*.xml
.venv/bin/python -m sphinx -b html -c tests/site -d build/site/doctrees -q -W --keep-going . build/site/html
echo "site: build/site/html/index.html"
