#!/usr/bin/env bash
# Effects that appear after the identification, compensated by the firmware of an emulated board: see README.md.
# Sets up what is missing.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
"$root/tests/support/setup.sh" board
exec "$root/.venv/bin/python" "$root/examples/shrink/shrink.py" "$@"
