"""The frame that every command shares: exit status, messages, --json, progress."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import click
import click.testing
import numpy as np
import pytest
from models import random_model

import rdpi.cli
from rdpi.cli import main
from rdpi.data import write_recording
from rdpi.errors import BadInput
from rdpi.model import write_model

HOST_TOOLS = Path(__file__).resolve().parents[1]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(HOST_TOOLS)}


def program(*arguments: str, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "rdpi", *arguments], env=ENVIRONMENT, capture_output=True, text=True,
                          **options)


@pytest.fixture
def scratch() -> Iterator[Callable[[Callable], None]]:
    """Make a function the command `scratch` for one test."""

    def add(function: Callable) -> None:
        rdpi.cli.command("scratch")(function)

    yield add
    rdpi.cli.main.commands.pop("scratch", None)


def test_as_a_program(tmp_path: Path) -> None:
    done = program("excite", "startup", "-o", "drive.csv", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "") and (tmp_path / "drive.csv").exists()
    refused = program("import", "nowhere.csv", "-o", "run.csv", cwd=tmp_path)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr == ("rdpi: nowhere.csv: cannot be read (No such file or directory); check the file name and "
                              "permissions\n")


def test_version(rdpi: Callable) -> None:
    result = rdpi("--version")
    assert result.exit_code == 0 and result.output.startswith("rdpi, version ")


def test_starts_without_numpy() -> None:
    """Help must not wait for the heavy imports."""
    heavy = "numpy", "scipy", "matplotlib", "rich"
    check = f"import sys, rdpi.cli; sys.exit(any(name in sys.modules for name in {heavy}))"
    assert subprocess.run([sys.executable, "-c", check], env=ENVIRONMENT).returncode == 0


def test_the_list_of_commands_cuts_no_line(rdpi: Callable) -> None:
    listed = rdpi("--help").output.partition("Commands:")[2].strip().splitlines()
    assert len(listed) == len(main.commands) and not [line for line in listed if line.endswith("...")]


def test_every_command_has_help_and_json(rdpi: Callable) -> None:
    for name, command in main.commands.items():
        result = rdpi(name, "--help")
        assert result.exit_code == 0 and "--json FILE" in result.output
        for parameter in command.params:
            if isinstance(parameter, click.Option):
                assert parameter.help, f"{name} {parameter.opts[0]}"


def test_usage_error_is_status_2(rdpi: Callable) -> None:
    for arguments in (["fly"], ["import"], ["excite", "sine"], ["excite", "sine", "-o", "x", "--wings", "2"]):
        assert rdpi(*arguments).exit_code == 2


@pytest.mark.parametrize("target", ["missing/drive.csv", "."])
def test_unwritable_output(target: str, rdpi: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = rdpi("excite", "startup", "-o", target)
    assert result.exit_code == 2 and target in result.output and "Traceback" not in result.output
    assert list(tmp_path.iterdir()) == []


def test_unwritable_json(rdpi: Callable, tmp_path: Path) -> None:
    result = rdpi("excite", "startup", "-o", tmp_path / "drive.csv", "--json", tmp_path / "missing" / "result.json")
    assert result.exit_code == 2
    missing = tmp_path / "missing"
    assert f"rdpi: {missing / 'result.json'}: there is no directory {missing}" in result.output
    assert not (tmp_path / "drive.csv").exists()  # found before the work


@pytest.mark.parametrize("words, message", [
    ("-o new --report new", "new: is the directory of --report too; give another name"),
    ("-o new.json --json new --report ./new/", "new: is the directory of --report too"),
    ("-o new.json --report dangling", "dangling: is not a directory; give another name for --report"),
    ("-o new.json --report run.csv/x/y", "run.csv: is not a directory; give another name for --report"),
    ("-o new/fit.png --report new", "new/fit.png: would be written over another output"),
    (["-o", ""], "-o: the name is empty; give a name"),
    (["-o", "new.json", "--json", ""], "--json: the name is empty"),
    (["-o", "new.json", "--report", ""], "--report: the name is empty"),
    (["-o", "new.json", "--hold-out", ""], "--hold-out: the name is empty"),
])
def test_names_that_make_no_output(words: str | list[str], message: str, rdpi: Callable, tmp_path: Path,
                                   monkeypatch: pytest.MonkeyPatch) -> None:
    """Found before the work: a run is not even read."""
    monkeypatch.chdir(tmp_path)
    Path("dangling").symlink_to("nowhere")
    Path("run.csv").touch()
    result = rdpi("fit", "run.csv", *(words.split() if isinstance(words, str) else words))
    assert result.exit_code == 2 and f"rdpi: {message}" in result.output
    assert {path.name for path in tmp_path.iterdir()} == {"dangling", "run.csv"}


def test_json_replaces_in_one_step(rdpi: Callable, scratch: Callable, tmp_path: Path) -> None:
    import numpy as np
    path = tmp_path / "result.json"
    scratch(lambda: {"count": np.int64(3), "values": np.array([1.5, 2.0]), "none": None})
    assert rdpi("scratch", "--json", path).exit_code == 0
    assert json.loads(path.read_text()) == {"count": 3, "values": [1.5, 2.0], "none": None}
    before = path.read_bytes()

    def bad() -> dict:
        raise BadInput("run.csv:3: wrong; repair it")

    scratch(bad)
    result = rdpi("scratch", "--json", path)
    assert result.exit_code == 2 and result.output == "rdpi: run.csv:3: wrong; repair it\n"
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_bugs_are_not_hidden(rdpi: Callable, scratch: Callable) -> None:
    """Only bad input is explained away; a mistake of ours keeps its traceback."""

    def bug() -> dict:
        raise ValueError("ours")

    scratch(bug)
    assert isinstance(rdpi("scratch").exception, ValueError)


SLOW = """
import time
from rdpi.cli import progress
progress.DELAY_S = 0.05
with progress.progress("working") as report:
    time.sleep({before}); report(0.5); time.sleep(0.3)
"""


def on_a_terminal(code: str) -> str:
    """What a program writes when its stderr is a terminal."""
    terminal, end = pty.openpty()
    child = subprocess.Popen([sys.executable, "-c", code], env=ENVIRONMENT | {"TERM": "xterm"}, stderr=end)
    os.close(end)
    shown = b""
    try:
        while chunk := os.read(terminal, 4096):
            shown += chunk
    except OSError:  # Linux: the other end is closed
        pass
    os.close(terminal)
    assert child.wait() == 0
    return shown.decode()


def test_progress_on_a_terminal() -> None:
    for before in (0.3, 0):
        shown = on_a_terminal(SLOW.format(before=before))
        assert "working" in shown and "50%" in shown
    assert on_a_terminal(SLOW.format(before=0).replace("0.05", "60")) == ""  # quick work shows nothing and ends at once


def test_no_progress_when_piped() -> None:
    done = subprocess.run([sys.executable, "-c", SLOW.format(before=0.2)], env=ENVIRONMENT, capture_output=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_a_closed_pipe_is_no_error(tmp_path: Path) -> None:
    """`rdpi … | head` does its work without a message."""
    table = "t,voltage,position\n" + "".join(f"{k / 1000},{k % 7},{k % 5}\n" for k in range(100))
    for index in range(40):
        (tmp_path / f"{index}.csv").write_text(table)
    command = [sys.executable, "-u", "-m", "rdpi", "import", *tmp_path.iterdir(), "-o", tmp_path / "runs"]
    child = subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    child.stdout.close()
    assert child.stderr.read() == b"" and child.wait() == 0
    assert len([*(tmp_path / "runs").iterdir()]) == 40


def test_what_is_written_last_is_written_after_the_pipe_is_closed(tmp_path: Path) -> None:
    """rdpi compensate says what the inverse does before it writes the drive."""
    write_model(tmp_path / "m.json", random_model(3))
    time_s = np.arange(100) / 1000
    write_recording(tmp_path / "r.csv", {"time_s": time_s, "reference_um": np.sin(time_s)}, {})
    for words, written in ((["compensate", "m.json", "r.csv", "-o", "d.csv"], "d.csv"),
                           (["header", "m.json", "-o", "p.h"], "p.h")):
        child = subprocess.Popen([sys.executable, "-u", "-m", "rdpi", *words], env=ENVIRONMENT, cwd=tmp_path,
                                 stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        child.stdout.close()
        assert child.stderr.read() == b"" and child.wait() == 0 and (tmp_path / written).stat().st_size


def test_import_into_the_folder_of_its_source(rdpi: Callable, scratch: Callable, tmp_path: Path) -> None:
    """The recording would have the source's name."""
    source = tmp_path / "x.csv"
    source.write_text("t_s,V,um\n" + "".join(f"{k / 100},{k % 7},{k % 5}\n" for k in range(20)))
    before = source.read_bytes()
    result = rdpi("import", source, "--time", "t_s", "--command", "V", "--displacement", "um", "-o", tmp_path)
    assert result.exit_code == 2 and "over an input" in result.output and source.read_bytes() == before


def test_ctrl_c_is_no_missed_gate(tmp_path: Path, rdpi: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("rdpi.data.make_drive", stopped)
    done = rdpi("excite", "sine", "-o", tmp_path / "drive.csv")
    assert (done.exit_code, done.output) == (130, "rdpi: stopped\n")
    assert not list(tmp_path.iterdir())


# The program, in which looking for a module sends what Ctrl-C does.
INTERRUPTED = """
import os, signal, sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == MODULE:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)
MODULE = sys.argv.pop(1)
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
sys.meta_path.insert(0, Interrupt())
from rdpi.__main__ import main
main()
"""


@pytest.mark.parametrize("module", ["rdpi.cli", "click", "numpy", "rdpi.identify.identify", "scipy"])
def test_ctrl_c_while_modules_are_loaded(module: str, tmp_path: Path) -> None:
    """They are loaded for longer than small work takes."""
    (tmp_path / "run.csv").write_text("time_s,command_V,displacement_um\n"
                                      + "".join(f"{k / 100},{k % 7},{k % 7}\n" for k in range(40)))
    done = subprocess.run([sys.executable, "-c", INTERRUPTED, module, "fit", "run.csv", "-o", "model.json"],
                          env=ENVIRONMENT, cwd=tmp_path, capture_output=True, text=True)
    assert (done.stderr, done.returncode) == ("rdpi: stopped\n", 130)
    assert [path.name for path in tmp_path.iterdir()] == ["run.csv"]


# --- --json - ------------------------------------------------------------------------------------------------------

def test_json_to_standard_output_and_nothing_else(tmp_path: Path) -> None:
    done = program("excite", "startup", "-o", "drive.csv", "--json", "-", cwd=tmp_path)
    assert json.loads(done.stdout)["kind"] == "startup" and "drive.csv: startup" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["drive.csv"]


def test_json_to_standard_output_of_every_command(scratch: Callable, tmp_path: Path,
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    """What a command prints goes elsewhere; a missed gate and bad input keep their status."""
    monkeypatch.chdir(tmp_path)
    runner = click.testing.CliRunner(**({"mix_stderr": False} if click.__version__ < "8.2" else {}))

    def missed() -> dict:
        click.echo("for people")
        return {"gate_failed": True}

    def bad() -> dict:
        click.echo("for people")
        raise BadInput("run.csv: bad")

    for function, code, output in ((missed, 1, '{\n  "gate_failed": true\n}\n'), (bad, 2, "")):
        scratch(function)
        result = runner.invoke(main, ["scratch", "--json", "-"])
        assert (result.exit_code, result.stdout) == (code, output) and "for people" in result.stderr
        main.commands.pop("scratch")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["excite", "import", "header", "fit", "gap", "compensate", "simulate", "plot",
                                  "profile", "record"])
def test_other_outputs_are_files(name: str, rdpi: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    needed = {"excite": ["startup"], "compensate": ["m", "r"], "gap": ["m", "r"], "simulate": ["m", "r"],
              "plot": ["m", "r"]}
    result = rdpi(name, *needed.get(name, ["m"]), "-o", "-")
    assert result.exit_code == 2
    assert result.output == "rdpi: -o -: standard output is only for --json; give a file name\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("where, message", [
    (">&-", "--json -: standard output is closed; give a file name"),
    (">/dev/full", "standard output: No space left on device; check the path and permissions")])
def test_json_that_standard_output_does_not_take(where: str, message: str, tmp_path: Path) -> None:
    line = f'"{sys.executable}" -m rdpi excite startup -o drive.csv --json - {where}'
    done = subprocess.run(["sh", "-c", line], stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.splitlines()[-1] == f"rdpi: {message}", done.stderr


@pytest.mark.parametrize("words", [["import"], ["import", "--telemetry"]])
def test_what_has_no_end_is_not_read(words: list[str], tmp_path: Path, refused: Callable) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert "is a device" in refused(*words, "/dev/zero", "-o", refused.output)
    assert "this pipe is empty" in refused(*words, tmp_path / "pipe", "-o", refused.output)


@pytest.mark.parametrize("size", [3 << 30, 500 << 20])
def test_a_file_larger_than_memory(size: int, tmp_path: Path) -> None:
    with open(tmp_path / "large.csv", "wb") as file:
        file.truncate(size)
    line = f'ulimit -v 1000000; OPENBLAS_NUM_THREADS=1 "{sys.executable}" -m rdpi import large.csv -o out.csv'
    done = subprocess.run(["sh", "-c", line], stderr=subprocess.PIPE, text=True, cwd=tmp_path, timeout=60)
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("rdpi: large.csv: there is not enough memory"), done.stderr


def test_a_model_is_no_device(refused: Callable) -> None:
    assert refused("header", "/dev/zero", "-o", refused.output) == "/dev/zero: is a device; give a file"


def test_a_pipe_is_read(tmp_path: Path, rdpi: Callable) -> None:
    rows = "".join(f"{k / 1000},{k},{k}\n" for k in range(40))
    reader, writer = os.pipe()
    os.write(writer, f"time_s,command_V,displacement_um\n{rows}".encode())
    os.close(writer)
    done = rdpi("import", f"/dev/fd/{reader}", "-o", tmp_path / "run.csv")
    os.close(reader)
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize(("given", "taken"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")])
def test_linear_algebra_takes_one_thread_before_numpy_is_loaded(given: dict[str, str], taken: str) -> None:
    code = ("import os, sys, rdpi.__main__\n"
            "first = 'numpy' not in sys.modules\n"
            "sys.argv = ['rdpi', '--version']\n"
            "try:\n    rdpi.__main__.main()\n"
            "finally:\n    print(first, os.environ['OPENBLAS_NUM_THREADS'])")
    outside = {name: value for name, value in ENVIRONMENT.items() if "THREADS" not in name}
    done = subprocess.run([sys.executable, "-c", code], env=outside | given, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == f"True {taken}", done.stderr
