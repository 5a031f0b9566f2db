#!/usr/bin/env bash
# The whole loop on an emulated board with a virtual actuator, or on one of yours: see README.md.
# Sets up what is missing.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
"$root/tests/support/setup.sh" board
exec "$root/.venv/bin/python" "$root/examples/loop/loop.py" "$@"
