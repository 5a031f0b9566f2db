from __future__ import annotations

import json

from compare_names import compare

JUNIT = """<testsuite>
<testcase name="unit/test_play"><system-out>{}</system-out></testcase>
<testcase name="consumer/install"><system-out>-- Installing: lib/test_play.c</system-out></testcase>
</testsuite>"""


def junit(*lines: str) -> str:
    return JUNIT.format("\n".join((*lines, "2 Tests 0 Failures 1 Ignored")))


def report(**results: list[str]) -> str:
    return json.dumps(
        {
            kind: [{"file": "tests/unit/test_play.c", "test": test} for test in results.get(kind, [])]
            for kind in ("PassedTests", "FailedTests", "IgnoredTests")
        }
    )


MOVES = "/a b/tests/unit/test_play.c:9:test_moves:PASS"
WAITS = "/a b/tests/unit/test_play.c:15:test_waits:IGNORE: later"
BREAKS = "tests/unit/test_play.c:20:test_breaks:FAIL: Expected 1 Was 2"


def test_same_names_with_any_result():
    both = report(PassedTests=["test_moves"], FailedTests=["test_breaks"], IgnoredTests=["test_waits"])
    assert compare(junit(MOVES, WAITS, BREAKS), both) == []


def test_missing_on_either_side():
    assert compare(junit(MOVES, WAITS), report(PassedTests=["test_moves", "test_other"])) == [
        "only CTest executed test_play.c:test_waits",
        "only Ceedling executed test_play.c:test_other",
    ]


def test_nothing_executed():
    assert compare(junit(), report()) == ["neither runner executed a test"]
