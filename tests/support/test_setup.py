"""Set-up on machines that lack something."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

HERE = Path(__file__).parent
TOOLS = "awk bash cat dirname env find flock grep head mkdir rm sed sha256sum sort tail tr xargs".split()


def test_what_the_package_manager_says_is_shown(tmp_path: Path) -> None:
    """Also where its words are none that a compiler would use: the reason, and where the whole output is."""
    root, tools = tmp_path / "checkout", tmp_path / "bin"
    (root / "tests/support").mkdir(parents=True)
    tools.mkdir()
    shutil.copy(HERE / "setup.sh", root / "tests/support")
    (root / "project.yml").write_text(":ceedling_version: 1.2.1\n")
    for tool in TOOLS:
        (tools / tool).symlink_to(shutil.which(tool) or tool)
    for name, script in {"id": "echo 0", "apt-get": "echo 'W: the mirror is gone'; exit 100"}.items():
        (tools / name).write_text(f"#!/bin/bash\n{script}\n")
        (tools / name).chmod(0o755)
    done = subprocess.run([root / "tests/support/setup.sh", "demo"], env={"PATH": str(tools)}, capture_output=True, text=True)
    assert done.returncode == 1
    assert "    W: the mirror is gone" in done.stderr
    assert done.stderr.endswith("set-up: failed, whole output in build/setup.log: reading the package lists\n")
