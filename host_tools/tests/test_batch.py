"""`rdpi batch`: the plan, what is done again, workers and runs that die, results that cannot be written, the page."""

from __future__ import annotations

import asyncio
import concurrent.futures
import errno
import json
import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from models import random_model
from plants import quasi_static, stack, waves

from rdpi.data import reserved, write_recording
from rdpi.errors import BadInput
from rdpi.gap import batch
from rdpi.gap.batch import workers
from rdpi.model import write_model

QUICK = "--rate-independent --operators 4 --deadzones 0 --effects none"
RDPI = Path(sys.executable).with_name("rdpi")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(name: str, amplitude_V: float = 90.0, gain: float = 1.0, seed: int = 0) -> None:
    Path(name).parent.mkdir(exist_ok=True)
    drive = np.r_[waves(amplitude_V, 2, 2, 500), np.linspace(0, 50, 50)]
    made = quasi_static(stack(law=0), drive)
    noise = 0.01 * np.random.default_rng(seed).normal(size=len(drive))
    write_recording(name, {**made.columns, "displacement_um": gain * made.displacement_um + noise}, made.metadata)


def plan(*rows: str, names: str = "actuator,fit,gap,options") -> None:
    Path("plan.csv").write_text("\n".join([names, *rows]) + "\n")


def table(what: str = "actuator, status, error, verdict, effect, held_out_rms_percent") -> list[tuple]:
    connection = sqlite3.connect("results.sqlite")
    with connection:
        rows = connection.execute(f"SELECT {what} FROM results ORDER BY actuator").fetchall()
    connection.close()
    return rows


def worked_on(done) -> list[str]:
    """Actuators that a run of the command told of."""
    return sorted(line.split()[1].rstrip(":") for line in done.output.splitlines() if line[0].isdigit())


def many(count: int) -> None:
    for k in range(count):
        write(f"runs/A{k}.csv", seed=k)
    plan(*(f"A{k},runs/A{k}.csv,,{QUICK}" for k in range(count)))


def test_fit_and_diagnosis_stand_in_the_results(here, rdpi):
    write("runs/A-slow.csv", seed=1)
    write("runs/A-small.csv", 60, seed=2)
    write("runs/today.csv", 80, gain=1.2, seed=3)
    plan(f"A,runs/A-slow.csv,runs/A-small.csv,runs/to*.csv; runs/A-small.csv,{QUICK}",
         "B,,,runs/A-small.csv,", names="actuator,fit,hold_out,gap,options")
    done = rdpi("batch", "plan.csv", "-o", "results.sqlite", "--report", "pages", "--jobs", 1, "--json", "out.json")
    assert done.exit_code == 2, done.output
    (a, status, error, verdict, effect, held), (b, failed, why, *rest) = table()
    assert (a, status, error) == ("A", "done", None) and verdict and held > 0
    assert (b, failed, rest) == ("B", "failed", [None] * 3) and "there is no model models/B.json" in why
    assert json.loads(Path("out.json").read_text())["failed"] == 1
    connection = sqlite3.connect("results.sqlite")
    documents = {kind: json.loads(text) for kind, text in connection.execute("SELECT kind, document FROM documents")}
    connection.close()
    gap = documents["gap"]
    assert (gap["schema"], gap["verdict"]) == ("rdpi-gap/1", verdict) and len(gap["runs"]) == 2
    assert ", ".join(one["name"] for one in gap["effects"]) == (effect or "")
    assert max(run["rms_percent"] for run in documents["fit"]["runs"] if run["held_out"]) == held
    assert json.loads(Path("models/A.json").read_text())["actuator"] == "A"
    assert "pages/index.html: the report" in done.output
    page = Path("pages/index.html").read_text()
    assert 'href="A/index.html"' in page and 'href="A/fit.html"' in page and 'href="B/' not in page
    assert "there is no model models/B.json" in page


def test_limits_hold_for_all_actuators_of_the_plan(here, rdpi):
    for name, gain in (("A", 1.0), ("B", 1.3)):
        write(f"{name}.csv", seed=1)
        write(f"{name}-today.csv", 80, gain=gain, seed=3)
    plan(*(f"{name},{name}.csv,{name}-today.csv,{QUICK}" for name in "AB"))
    command = "batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1
    assert rdpi(*command, "--max-gap", 50, "--max-rms", 50).exit_code == 0
    (good, fitted, _), (gap, _, verdict) = table("gap_percent, fit_rms_percent, verdict")
    assert good < 0.5 * gap and verdict != "none"
    one = "rdpi: 1 beyond --max-rms, --fail-on or --max-gap: B"
    for limits, code, said in ((("--max-gap", 0.9 * gap), 1, f"{one} (gap {gap:.3g} %)"),
                               (("--max-gap", 1.1 * gap), 0, ""),
                               (("--fail-on", verdict), 1, f": B (verdict {verdict})"),
                               (("--max-rms", 0.5 * fitted), 1, f": A (rms {fitted:.3g} %), B (rms "),
                               (("--max-rms", 2 * fitted, "--fail-on", verdict, "--max-gap", 0.9 * gap), 1,
                                f": B (verdict {verdict}, gap {gap:.3g} %)")):
        done = rdpi(*command, *limits, "--json", "out.json")  # nothing is left to do
        assert done.exit_code == code and said in done.output and worked_on(done) == [], done.output
        assert json.loads(Path("out.json").read_text())["gate_failed"] == bool(code)
    plan(f"A,A.csv,A-today.csv,{QUICK}", f"B,B.csv,B-today.csv,{QUICK}", f"C,C.csv,,{QUICK}")
    assert rdpi(*command, "--fail-on", verdict).exit_code == 2  # one failed


@pytest.mark.parametrize(("row", "limit", "said"), [
    ("A,a.csv,,", ("--max-gap", 0.0001), "--max-gap: no row of plan.csv has recordings in gap; "),
    ("A,a.csv,,", ("--fail-on", "effect,ambiguous,unknown"), "--fail-on: no row of plan.csv has recordings in gap; "),
    ("A,,a.csv,m.json", ("--max-rms", 0.001), "--max-rms: no row of plan.csv has recordings in fit; "),
])
def test_a_limit_that_holds_for_no_actuator_is_refused(here, rdpi, row, limit, said):
    write("a.csv")
    write_model("m.json", random_model(1))
    plan(row, names="actuator,fit,gap,model")
    done = rdpi("batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1, *limit)
    assert done.exit_code == 2 and done.output.startswith(f"rdpi: {said}") and done.output.count("\n") == 1
    assert not Path("results.sqlite").exists()


def test_only_what_is_new_changed_or_failed_is_done_again(here, rdpi):
    for name in "ABC":
        write(f"{name}.csv")
    rows = [f"{name},{name}.csv,,{QUICK}" for name in "ABC"]
    plan(*rows, f"D,D.csv,,{QUICK}")
    command = "batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1
    assert worked_on(rdpi(*command)) == [*"ABCD"]
    assert worked_on(rdpi(*command)) == ["D"]
    write("D.csv")
    write("A.csv", 80)
    plan(*rows[:2], rows[2] + " --min-V 0", f"D,D.csv,,{QUICK}")
    done = rdpi(*command)
    assert (worked_on(done), done.exit_code) == ([*"ACD"], 0)
    Path("models/B.json").write_text(Path("models/A.json").read_text())
    assert worked_on(rdpi(*command)) == ["B"]
    assert worked_on(rdpi(*command)) == []
    assert worked_on(rdpi(*command, "--all")) == [*"ABCD"]


def test_a_model_that_is_read_counts_as_an_input(here, rdpi):
    write("A.csv")
    rdpi("fit", "A.csv", "-o", "A.json", *QUICK.split())
    plan("A,A.csv,A.json", names="actuator,gap,model")
    command = "batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1
    assert worked_on(rdpi(*command)) == ["A"] and worked_on(rdpi(*command)) == []
    model = json.loads(Path("A.json").read_text())
    Path("A.json").write_text(json.dumps({**model, "actuator": "another"}))
    assert worked_on(rdpi(*command)) == ["A"]


@pytest.mark.parametrize(("rows", "names", "said"), [
    ((), "actuator,fit", "has no rows"),
    (("A,a.csv",), "actuator,fits", "plan.csv:1: column 'fits' is not known"),
    (("A,a.csv",), "actuator,model", "plan.csv:1: a plan needs the column actuator and one of fit and gap"),
    (("A,a.csv,b.csv",), "actuator,fit,fit", "plan.csv:1: there are two columns fit"),
    (("A,a.csv,b.csv",), "actuator,fit", "plan.csv:2: 3 value(s) instead of 2"),
    ((",a.csv",), "actuator,fit", "plan.csv:2: column actuator is empty"),
    (("A,",), "actuator,fit", "plan.csv:2: give recordings in fit or in gap"),
    (("A,; ;",), "actuator,fit", "plan.csv:2: give recordings in fit or in gap"),
    (("A/B,a.csv",), "actuator,fit", "plan.csv:2: actuator 'A/B': must do as the name of a folder"),
    (("..,a.csv",), "actuator,fit", "plan.csv:2: actuator '..': must do as the name of a folder"),
    (("A,a.csv", "# a remark", "", "A,b.csv"), "actuator,fit", "plan.csv:5: A has a row already, line 2"),
    (("A,a.csv,m.json", "B,a.csv,./m.json"), "actuator,fit,model",
     "plan.csv:3: ./m.json would be written by line 2 too"),
    (("A,a.csv,a.csv",), "actuator,fit,model", "plan.csv:2: the model a.csv would be written over an input"),
    (("A,a.csv,,m.json", "B,,a.csv,m.json"), "actuator,fit,gap,model", "plan.csv:3: m.json is written by line 2"),
    (("A,a.csv,a.csv",), "actuator,gap,hold_out", "plan.csv:2: hold_out needs recordings in fit"),
    (("A,a.csv,a.csv",), "actuator,fit,earlier", "plan.csv:2: earlier needs recordings in gap"),
    (("A,a.csv,--operatrs 3",), "actuator,fit,options", "plan.csv:2: options: No such option: --operatrs"),
    (("A,a.csv,--report x",), "actuator,fit,options", "plan.csv:2: options: No such option: --report"),
    (("A,a.csv,--operators x",), "actuator,fit,options", "plan.csv:2: options: Invalid value for '--operators'"),
    (("A,a.csv,'",), "actuator,fit,options", "plan.csv:2: options: No closing quotation"),
    (("A,a.csv,--operators 500",), "actuator,fit,options", "plan.csv:2: options: --operators 500: must be 0 to 128"),
    (("A,a.csv,--slew -1",), "actuator,fit,options", "plan.csv:2: options: --slew -1: must be positive"),
    (('A,a.csv,"--thresholds 2,1"',), "actuator,fit,options", "plan.csv:2: options: --thresholds: must be positive"),
    (("A,a.csv,--without lag",), "actuator,fit,options",
     "plan.csv:2: options: --without: is only valid with recordings in gap"),
    (("A,a.csv,m.json,--min-V 3 --operators 3",), "actuator,gap,model,options",
     "plan.csv:2: options: --min-V: is only valid with recordings in fit"),
    (('A,"a.csv',), "actuator,fit", "plan.csv:2: is not CSV"),
    (("A;a.csv",), "actuator;fit", "the columns are actuator, fit, hold_out, gap, earlier, model, options, with commas"),
    (("A,a.csv,m\0.json",), "actuator,fit,model", "plan.csv: is not text; there is a byte of zero in it"),
    (("x" * 201 + ",a.csv",), "actuator,fit", "must do as the name of a folder; use at most 200 bytes"),
    (("漢" * 67 + ",a.csv",), "actuator,fit", "must do as the name of a folder; use at most 200 bytes"),
    (("A,a.csv,results.sqlite",), "actuator,fit,model", "results.sqlite: would be written over a file of A in plan.csv"),
    (("A,a.csv,results.sqlite",), "actuator,gap,model", "results.sqlite: would be written over a file of A in plan.csv"),
    (("A,a.csv,told.json",), "actuator,fit,model", "told.json: would be written over a file of A in plan.csv"),
    (("A,a.csv", "B,./told.json"), "actuator,fit", "told.json: would be written over a file of B in plan.csv"),
])
def test_plans_that_are_refused(here, rdpi, rows, names, said):
    write("a.csv")
    plan(*rows, names=names)
    Path("told.json").write_text("as it was")
    done = rdpi("batch", "plan.csv", "-o", "results.sqlite", "--json", "told.json")
    assert done.exit_code == 2 and said in done.output and done.output.count("\n") == 1
    assert not Path("results.sqlite").exists() and not Path("models").exists()
    assert Path("told.json").read_text() == "as it was"


def text_of(folder: str) -> dict[Path, bytes]:
    """Content of all files."""
    return {path: path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()}


OVER = "the report of A would be written over"


@pytest.mark.parametrize(("row", "options", "said"), [
    ("A,a.csv,,,rep/A/fit.json", (), f"plan.csv:2: {OVER} "),  # a model that is made
    ("A,a.csv,,a.csv,rep/A/gap.json", (), f"plan.csv:2: {OVER} "),
    ("A,,,a.csv,rep/A/gap.json", (), f"plan.csv:2: {OVER} "),  # one that is read
    ("A,,,a.csv,./rep/../rep/A/index.html", (), f"plan.csv:2: {OVER} "),
    ("A,a.csv,,,rep/A", (), f"plan.csv:2: {OVER} "),
    ("A,rep/A/fit.png,,,", (), f"plan.csv:2: {OVER} "),
    ("A,a.csv,rep/A/fit.html,,", (), f"plan.csv:2: {OVER} "),
    ("A,a.csv,,rep/A/fit.json,", (), f"plan.csv:2: {OVER} "),
    ("A,,,a.csv,kept.json", (), f"plan.csv:2: {OVER} "),  # what is kept with a model
    ("A,a.csv,,,rep/index.html", (), "rep/index.html: would be written over a file of A in plan.csv"),
    ("A,a.csv,,,", ("--json", "rep/A/fit.json"), f"plan.csv:2: {OVER} rep/A/fit.json; give another --report"),
    ("A,a.csv,,,", ("--json", "rep/A"), f"plan.csv:2: {OVER} rep/A; "),
    ("A,a.csv,,,", ("-o", "rep/A/fit.html"), f"plan.csv:2: {OVER} rep/A/fit.html; give another --report"),
    ("A,a.csv,,,", ("-o", "rep/index.html"), "rep/index.html: would be written over another output"),
    ("index.html,a.csv,,,", (), "plan.csv:2: actuator 'index.html': --report writes a page of this name"),
    ("Index.html,a.csv,,,", (), "plan.csv:2: actuator 'Index.html': --report writes a page of this name"),
    ("B,a.csv,,,", (), "rep/B: is not a directory; give another name for --report"),
])
def test_a_report_that_would_be_written_over_a_file_of_the_batch(here, rdpi, row, options, said):
    write("a.csv")
    Path("rep/A").mkdir(parents=True)
    for name in ("fit.json", "fit.png", "fit.html"):
        Path("rep/A", name).write_bytes(Path("a.csv").read_bytes())
    write_model("rep/A/gap.json", random_model(1))
    document = random_model(1).to_json()
    Path("kept.json").write_text(json.dumps({**document, "kept": [{"file": "rep/A/gap.json"}]}))
    Path("rep/B").write_text("notes")
    if "rep/A" in (*options, row.split(",")[4]):
        os.rename("rep/A", "rep/C")
    plan(row, names="actuator,fit,hold_out,gap,model")
    before = text_of(".")
    done = rdpi("batch", "plan.csv", "-o", "results.sqlite", "--report", "rep", *options)
    assert done.exit_code == 2 and done.output.startswith(f"rdpi: {said}") and done.output.count("\n") == 1, done.output
    assert text_of(".") == before


def test_a_report_is_not_written_over_the_plan(here, rdpi):
    write("a.csv")
    Path("rep/A").mkdir(parents=True)
    plan("A,../../a.csv", names="actuator,fit")
    os.rename("plan.csv", "rep/A/fit.json")
    done = rdpi("batch", "rep/A/fit.json", "-o", "results.sqlite", "--report", "rep")
    assert done.exit_code == 2 and f"{OVER} rep/A/fit.json; give another --report" in done.output


def test_a_folder_of_pages_may_hold_other_files_too(here, rdpi):
    write("a.csv")
    plan(f"A,a.csv,rep/A/model.json,{QUICK}", names="actuator,fit,model,options")
    for options in ([], ["--report", "rep", "--all"]):  # the second with rep/A/model.json there
        done = rdpi("batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1, *options)
        assert done.exit_code == 0, done.output
    assert {path.name for path in Path("rep/A").iterdir()} == {"model.json", *batch.page.FILES["fit"]}


def test_no_model_is_written_over_what_is_kept_with_one_that_is_read(here, rdpi):
    write("a.csv")
    write("b.csv", 70)
    assert rdpi("fit", "a.csv", "-o", "m.json", "--keep", "kept", *QUICK.split()).exit_code == 0
    copy, = Path("kept").iterdir()
    whole = copy.read_bytes()
    plan(f"A,b.csv,,{copy}", "B,,a.csv,m.json", names="actuator,fit,gap,model")
    done = rdpi("batch", "plan.csv", "-o", "results.sqlite")
    assert done.exit_code == 2 and f"plan.csv:2: the model {copy} would be written over an input" in done.output
    plan("B,,a.csv,m.json", names="actuator,fit,gap,model")
    done = rdpi("batch", "plan.csv", "-o", copy)
    assert done.exit_code == 2 and f"{copy}: would be written over a file of B in plan.csv" in done.output
    done = rdpi("batch", "plan.csv", "-o", "results.sqlite", "--json", copy)
    assert done.exit_code == 2 and f"{copy}: is a table that is there already" in done.output
    assert copy.read_bytes() == whole and not Path("results.sqlite").exists()


@pytest.mark.parametrize("end", ["\r\n", "\r"])
def test_a_plan_of_another_system(here, rdpi, end):
    write("a.csv")
    Path("plan.csv").write_bytes(f"\ufeffactuator,fit,options{end}{end}A,a.csv,{QUICK}{end}".encode())
    assert worked_on(rdpi("batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1)) == ["A"]


@pytest.mark.parametrize(("row", "said"), [
    ("A,no.csv,,", "fit: there is no file no.csv"),
    ("A,runs/*.csv,,", "fit: there is no file runs/*.csv"),
    ("A,.,,", "fit: there is no file ."),
    ("A,/dev/zero,,", "fit: there is no file /dev/zero"),  # which has no end
    ("A,pipe,,", "fit: there is no file pipe"),
    ("A,,a.csv,", "there is no model models/A.json"),
    ("A,damaged.csv,,", "damaged.csv"),
    ("A,a.csv,damaged.csv," + QUICK, "damaged.csv"),
    ("A,a.csv,a.csv,--without nothing " + QUICK, "nothing"),
    ("A,a.csv,,--min-V 5 --max-V 1 " + QUICK, "--max-V 1: must be above the lowest drive, 5 V; give --min-V and --max-V"),
])
def test_a_row_that_fails_says_why_and_stops_no_other(here, rdpi, row, said):
    write("a.csv")
    Path("damaged.csv").write_text("time_s,command_V,displacement_um\n0,1,x\n")
    os.mkfifo("pipe")
    plan(row, f"Z,a.csv,,{QUICK}")
    done = rdpi("batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1)
    assert done.exit_code == 2
    (_, status, error, *_), (_, other, *_) = table()
    assert (status, other) == ("failed", "done") and said in error and "Traceback" not in done.output


def test_results_that_are_something_else_are_left_alone(here, rdpi):
    write("a.csv")
    plan(f"A,a.csv,,{QUICK}")
    command = "batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1
    Path("results.sqlite").write_text("a diary, of which not a word must be lost" * 100)
    done = rdpi(*command)
    assert done.exit_code == 2 and "results.sqlite: file is not a database" in done.output
    assert Path("results.sqlite").read_text().startswith("a diary")
    Path("results.sqlite").unlink()
    connection = sqlite3.connect("results.sqlite")
    connection.execute("CREATE TABLE addresses (name TEXT)")
    connection.close()
    done = rdpi(*command)
    assert done.exit_code == 2 and "is a database of something else" in done.output


@pytest.mark.parametrize(("changes", "said"), [
    ("DROP TABLE documents; CREATE TABLE documents (name TEXT)", "is a database of something else"),
    ("UPDATE results SET gap_percent = 'low'", "the row of A has gap_percent 'low', which rdpi does not write"),
    ("UPDATE results SET actuator = NULL", "the row of None has actuator None, which rdpi does not write"),
])
def test_results_that_somebody_has_changed_are_refused_before_the_work(here, rdpi, changes, said):
    write("a.csv")
    plan(f"A,a.csv,,{QUICK}")
    command = "batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1
    assert rdpi(*command).exit_code == 0
    connection = sqlite3.connect("results.sqlite")
    connection.executescript(changes)
    connection.close()
    as_it_was = Path("results.sqlite").read_bytes()
    done = rdpi(*command, "--report", "pages", "--all")
    assert (done.exit_code, worked_on(done)) == (2, []) and f"rdpi: results.sqlite: {said}" in done.output
    assert Path("results.sqlite").read_bytes() == as_it_was


def test_results_that_cannot_be_written_are_told_before_the_work(here, rdpi, monkeypatch):
    many(1)
    command = "batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1
    assert rdpi(*command).exit_code == 0
    Path("models/A0.json").unlink()
    connect = sqlite3.connect  # read-only, which root needs to be told
    monkeypatch.setattr(sqlite3, "connect", lambda path, **options: connect(f"file:{path}?mode=ro", uri=True))
    done = rdpi(*command, "--all")
    assert (done.exit_code, worked_on(done)) == (2, []) and "attempt to write a readonly database" in done.output
    assert not Path("models/A0.json").exists()


@pytest.mark.slow
def test_who_reads_the_results_does_not_end_the_batch(here, rdpi):
    many(1)
    command = "batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1
    assert rdpi(*command).exit_code == 0
    reader = sqlite3.connect("results.sqlite", isolation_level=None, check_same_thread=False)
    reader.execute("BEGIN")
    reader.execute("SELECT * FROM results").fetchall()
    end = threading.Timer(8.0, reader.close)  # SQLite's own patience are 5 s
    end.start()
    done = rdpi(*command, "--all")
    end.join()
    assert (done.exit_code, worked_on(done)) == (0, ["A0"]), done.output


def test_a_full_disk_ends_the_batch_with_words_and_loses_nothing(here, rdpi, monkeypatch):
    many(3)
    write_row, written = batch.Results.write, []

    def full(self, row, documents):
        if written:  # as SQLite has it; a disk of its own needs root
            self._connection.execute("PRAGMA max_page_count = 1")
        written.append(row.actuator)
        write_row(self, row, {**documents, "fit": {"long": "x" * 100_000}} if len(written) > 1 else documents)

    monkeypatch.setattr(batch.Results, "write", full)
    done = rdpi("batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1)
    assert done.exit_code == 2 and "database or disk is full" in done.output and "goes on from there" in done.output
    assert [name for name, *_ in table()] == ["A0"]
    monkeypatch.undo()
    os.chdir(here)
    assert worked_on(rdpi("batch", "plan.csv", "-o", "results.sqlite", "--jobs", 1)) == ["A1", "A2"]


def test_a_second_batch_to_the_same_results_is_refused(here, rdpi):
    many(1)
    with reserved("results.sqlite"):
        done = rdpi("batch", "plan.csv", "-o", "results.sqlite")
    assert done.exit_code == 2 and "another rdpi is writing to this file" in done.output


def die_once(task: batch.Task) -> object:
    """A worker that is killed while it has this task for the first time, and always with one called "heavy"."""
    mark = Path(f"{task.actuator}.died")
    if task.actuator == "heavy" or not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return task.actuator


def test_the_work_of_a_process_that_is_killed_is_begun_again(here):
    tasks = [batch.Task(name, {}, "", "") for name in ("A", "heavy", "B", "C")]
    outcomes = list(workers.on_this_machine(tasks, die_once, 2))
    [given_up] = [one for one in outcomes if not isinstance(one, str)]
    assert sorted(one for one in outcomes if isinstance(one, str)) == ["A", "B", "C"]
    assert given_up.row.actuator == "heavy" and f"died, {workers.ATTEMPTS} times" in given_up.row.error


@pytest.mark.parametrize("most", [1, 0])
def test_where_no_more_processes_can_be_started_those_that_there_are_do_it(here, rdpi, monkeypatch, most):
    many(3)
    start, started = workers._start, []

    def limited(work):
        if len(started) >= most:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        started.append(start(work))
        return started[-1]

    monkeypatch.setattr(workers, "_start", limited)
    done = rdpi("batch", "plan.csv", "-o", "results.sqlite", "--jobs", 3)
    assert worked_on(done) == ["A0", "A1", "A2"][:3 * most] and done.exit_code == (0 if most else 2)
    assert ("rdpi: no process can be started (Too many open files); " in done.output) == (not most)


def wait_for_the_end_of(processes: list[str], at_most_s: float = 20.0) -> None:
    until = time.monotonic() + at_most_s
    while left := [one for one in processes if os.path.exists(f"/proc/{one}/exe")]:  # a zombie has none
        assert time.monotonic() < until, f"still there: {left}"
        time.sleep(0.05)


@pytest.mark.slow
def test_nothing_is_lost_and_nothing_twice_when_workers_and_runs_are_killed(here):
    many(12)
    command = [RDPI, "batch", "plan.csv", "-o", "results.sqlite", "--jobs", "2"]
    chance = np.random.default_rng(1)
    told: list[str] = []
    for kill in range(10):  # of runs, and in each of a worker
        with open("out.txt", "w") as out:
            process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, start_new_session=True)
            time.sleep(chance.uniform(1.0, 3.0))
            children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
            for child in children[-1:]:  # the first is Python's own, which cleans up
                os.kill(int(child), signal.SIGKILL)
            time.sleep(chance.uniform(0.2, 1.0))
            process.kill()
            process.wait()
        told += [line.split()[1] for line in Path("out.txt").read_text().splitlines() if line[0].isdigit()]
        wait_for_the_end_of(children)
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    assert [(name, status) for name, status in table("actuator, status")] == sorted(
        (f"A{k}", "done") for k in range(12))
    assert len(told) == len(set(told))  # what was told was written, and not done again
    again = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert again == "results.sqlite: 12 of 12 actuators done\n"


def test_ctrl_c_ends_the_workers_too(here):
    many(4)
    process = subprocess.Popen([RDPI, "batch", "plan.csv", "-o", "results.sqlite", "--jobs", "2", "--all"],
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler))
    time.sleep(2)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode in (0, 130) and "Traceback" not in errors
    wait_for_the_end_of(children)


CLUSTER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, processes=True) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


@pytest.fixture
def cluster(here):
    Path("cluster.py").write_text(CLUSTER)
    process = subprocess.Popen([sys.executable, "cluster.py"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
                               cwd=here, start_new_session=True)
    address = process.stdout.readline().strip()
    yield address, process
    if process.poll() is None:
        process.communicate(timeout=60)


@pytest.mark.slow
def test_a_cluster_gives_the_same_rows(here, rdpi, cluster):
    many(4)
    plan(*Path("plan.csv").read_text().splitlines()[1:], "Z,no.csv,,")
    what = "actuator, status, error, verdict, fit_rms_percent, model_path, model_sha256, inputs_sha256, tool"
    assert rdpi("batch", "plan.csv", "-o", "results.sqlite", "--jobs", 2).exit_code == 2
    here_made = table(what)
    done = rdpi("batch", "plan.csv", "-o", "results.sqlite", "--scheduler", cluster[0], "--all")
    assert done.exit_code == 2 and worked_on(done) == ["A0", "A1", "A2", "A3", "Z"], done.output
    assert table(what) == here_made


@pytest.mark.slow
def test_a_scheduler_that_goes_away_ends_the_batch_with_words(here, cluster):
    many(30)
    process = subprocess.Popen([RDPI, "batch", "plan.csv", "-o", "results.sqlite", "--scheduler", cluster[0]],
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    first = process.stdout.readline()
    os.killpg(cluster[1].pid, signal.SIGKILL)
    cluster[1].wait()
    out, errors = process.stdout.read(), process.stderr.read()  # communicate() loses what readline() has read ahead
    assert process.wait(timeout=120) == 2 and "the scheduler went away" in errors and "Traceback" not in errors
    ended = {line.split()[1].rstrip(":") for line in [first, *out.splitlines()]}
    assert {name for name, status in table("actuator, status") if status == "done"} == ended != set()


@pytest.mark.parametrize("raised", [OSError, asyncio.CancelledError, concurrent.futures.CancelledError, TypeError])
def test_a_scheduler_that_goes_away_while_an_outcome_is_asked_for(raised):
    class Future:
        def cancelled(self):
            return False

        def exception(self):
            return None

        def result(self):
            raise raised

    with pytest.raises(BadInput, match="the scheduler went away"):
        workers._outcome(Future(), batch.Task("A", {}, "", ""), "tcp://here:1")


def test_a_scheduler_that_is_not_there(here, rdpi, monkeypatch):
    monkeypatch.setattr(workers, "CONNECT_S", 1)
    many(1)
    done = rdpi("batch", "plan.csv", "-o", "results.sqlite", "--scheduler", "tcp://127.0.0.1:9")
    assert done.exit_code == 2 and "no Dask scheduler answers there" in done.output
    done = rdpi("batch", "plan.csv", "-o", "results.sqlite", "--scheduler", "nonsense://", "--jobs", 2)
    assert done.exit_code == 2 and "--jobs: is for this machine" in done.output


@pytest.mark.parametrize("address", ["nonsense://x", "x", "", "tcp://", "tcp://[::1", "inproc://x", "ucx://x:1",
                                     "tls://localhost:1"])
def test_an_address_that_is_none_ends_with_words_and_at_once(here, address):
    many(1)
    done = subprocess.run([RDPI, "batch", "plan.csv", "-o", "results.sqlite", "--scheduler", address],
                          capture_output=True, text=True, timeout=25)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"rdpi: --scheduler {address}: no Dask scheduler answers there (")
