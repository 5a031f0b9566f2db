#!/usr/bin/env bash
# Two axes of a stage on an emulated board, with cross coupling: see README.md.
# Sets up what is missing.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
"$root/tests/support/setup.sh" board
exec "$root/.venv/bin/python" "$root/examples/stage/stage.py" "$@"
