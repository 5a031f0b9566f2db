"""The golden vectors are what the script makes of the library and of exact arithmetic today."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def test_vectors_are_up_to_date() -> None:
    subprocess.run([sys.executable, Path(__file__).with_name("q31.py"), "--check"], check=True)
