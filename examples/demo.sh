#!/usr/bin/env bash
# The main job on virtual actuators: record, identify, generate the header, build, run the inverse, report accuracy.
# Sets up what is missing first. Results in build/demo/.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
"$root/tests/support/setup.sh" demo
exec "$root/.venv/bin/python" "$root/examples/demo/demo.py"
