"""What is said of an identification."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_chain import paper_model, run_after

from rdpi.errors import BadInput
from rdpi.identify import report, summary
from rdpi.identify.bands import RateSlopes
from rdpi.identify.identify import Fit, RunScore
from rdpi.identify.sweep_start import SweepStart
from rdpi.simulate import chain


def fitted(*percents: float, held_out: tuple[bool, ...] = ()) -> Fit:
    """The result of a fit whose runs were predicted so well."""
    model = paper_model()
    model.rate.identified_um_per_s = 500.0
    run = run_after(0.5)[1]
    scores = [RunScore(replace(run, path=f"{k}.csv"), k < len(held_out) and held_out[k],
                       chain.Score(0.1, 0.2, percent, 2 * percent, 0.0), "reset") for k, percent in enumerate(percents)]
    bands = RateSlopes(np.array([100.0]), np.full((1, 10), np.nan), np.array([5]))
    sweep = SweepStart(0.25, "beginnings", 0.012, 0.034, False, model.thresholds_um, (0.0, 12.5))
    return Fit(model, (0.01, 0.02), scores, bands, 0.003, sweep, ["something to know"])


def test_what_a_model_is_judged_by() -> None:
    assert summary.worst_rms_percent(fitted(1.0, 3.0, 2.0)) == 3.0
    assert summary.worst_rms_percent(fitted(1.0, 3.0, 2.0, held_out=(True, False, True))) == 2.0


def test_lines() -> None:
    result = fitted(1.0, 3.0, held_out=(False, True))
    lines = summary.lines(result)
    assert lines[0].startswith("9 plays, 1 dead zones, stroke 12.5 um") and "0.003 um" in lines[0]
    assert [line.split()[0] for line in lines[2:4]] == ["0.csv", "1.csv"]
    assert lines[2].endswith("fitted") and lines[3].endswith("held out")
    assert lines[6].split()[:2] == ["100", "um/s"] and lines[6].count(" -") == 10  # no slope could be fitted alone
    assert [round(float(word), 3) for word in lines[7].split()[3:]] == pytest.approx(result.model.slopes)
    assert any("1 % rms" in line and "2 %" in line for line in lines)
    low, high = chain.reachable_um(result.model)
    assert any(f"{low:.5g} to {high:.5g} um" in line for line in lines)
    assert any("500 um/s" in line and "1160 um/s" in line for line in lines)
    assert any("plays stay behind by 25 % of what ideal plays would" in line for line in lines)
    assert lines[-1] == "note: something to know"
    assert not any("residual" in line for line in summary.lines(replace(result, residual=(0.01, 0.01))))


def test_a_constant_that_is_most_of_what_is_missed_is_told() -> None:
    result = fitted(1.0, 2.0)
    result.scores[1] = result.scores[1]._replace(score=chain.Score(0.5, 1.0, 2.0, 4.0, -0.4))
    lines = summary.lines(result)
    assert lines[2].endswith("fitted") and lines[3].endswith("fitted; 1.2 % beside an offset of -0.4 um")


def test_a_low_pass_on_the_rate_is_told_where_slopes_follow_it() -> None:
    result = fitted(1.0)
    result.model.rate.filter_s = 0.1
    assert any("behind a low-pass of 0.1 s" in line for line in summary.lines(result))
    result.model.slope_rate_s_per_um = np.zeros(10)
    assert not any("low-pass" in line for line in summary.lines(result))


def test_the_report(tmp_path: Path) -> None:
    result = fitted(1.0)
    document = result.document("m.json", gate_failed=False)
    summary.write_report(tmp_path / "new" / "report", result, [run_after(0.5)[1]], document)
    written = {path.name: path for path in (tmp_path / "new" / "report").iterdir()}
    assert set(written) == {"fit.html", "fit.png", "fit.json"}
    assert "The model predicts" in written["fit.html"].read_text("utf-8")
    assert json.loads(written["fit.json"].read_text()) == document.to_json()
    assert written["fit.png"].read_bytes().startswith(b"\x89PNG")


def test_names_of_pictures() -> None:
    for name in ("a.png", "b/c.SVG", "d.e.pdf"):
        report.check_picture_name(name)
    for name in ("a", "a.jpg", "png", "a.png/b"):
        with pytest.raises(BadInput, match=r"\.png, \.svg or \.pdf"):
            report.check_picture_name(name)
