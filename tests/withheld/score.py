"""Verdicts against labels: the table of gap.md with intervals, rows per effect and severity, the confusion matrix."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from actuators import IN_CATALOGUE
from cases import GROUP_OF, Case

Z = 1.959964  # of a 95 % interval
RESAMPLES = 1000
DETECTABLE, NAMEABLE, GREW = 1.0, 2.0, 1.1  # rho from which effects are to be detected, named; growth of a residual
SMALL = 0.2  # rho from which it is told what is found of smaller ones
# Which effect, where it is itself not in the catalogue, others reproduce to three quarters or more: named instead, that
# is no slip of the diagnosis. From the table "What can be told apart" of the design, both ways, and by construction.
TWINS: dict[str, set[str]] = {
    "delay": {"lag", "resonance", "rate_dependence"}, "lag": {"delay", "slew_limit"},
    "slew_limit": {"lag"}, "resonance": {"delay", "lag"}, "rate_dependence": {"delay", "lag", "hysteresis_change"},
    "creep": {"thermal_drift", "hysteresis_change"}, "thermal_drift": {"creep", "gain_change"},
    "gain_change": {"thermal_drift", "static_nonlinearity"}, "rail_saturation": {"static_nonlinearity"},
    "static_nonlinearity": {"hysteresis_change", "rail_saturation"}, "backlash": {"hysteresis_change"},
    "hysteresis_change": {"creep", "static_nonlinearity", "rate_dependence", "backlash"},
    "sensor_hysteresis": {"hysteresis_change"}, "dead_band": {"static_nonlinearity"},
}
BEFORE_MONITOR = {"DAC", "timing", "amplifier", "before the monitor"}  # stages, as the tool names them
FAST, PLACE = {"rate_um_per_s", "frequency_hz"}, {"position_um", "amplitude_um"}
TURNS, TIME = {"since_reversal_s", "direction"}, {"time_s", "recording"}
WHERE: dict[str, set[str]] = {  # axes that the effect's gap concentrates on
    "delay": FAST, "lag": FAST, "slew_limit": FAST | TURNS, "resonance": FAST | TURNS,
    "rate_dependence": FAST | {"direction"}, "quantisation": FAST,
    "rail_saturation": PLACE, "static_nonlinearity": PLACE, "gain_change": PLACE,
    "hysteresis_change": TURNS | PLACE, "backlash": TURNS | PLACE,
    "creep": TURNS | TIME | {"frequency_hz"}, "initial_memory": TIME, "thermal_drift": TIME | {"frequency_hz"},
    "periodic_disturbance": {"frequency_hz"}, "cross_coupling": TIME | {"frequency_hz"},
}


@dataclass
class Judged:
    """A case with its verdict in the terms of the score."""

    case: Case
    verdict: str  # of the tool, or "failed"
    first: str  # name of the first accepted effect, "" without one
    rivals: tuple[str, ...]  # its confusable_with
    ranked: tuple[str, ...]  # accepted, then rivals, then candidates by their shrink
    accepted: tuple[str, ...]
    detection: float
    promised: float | None
    interval: tuple[float, float] | None
    realised: float | None
    dominant: str
    stage: str
    seconds: float

    @property
    def answer(self) -> str:
        """The first name, or the verdict where it names nothing."""
        return self.first if self.verdict in ("effect", "ambiguous") and self.first else self.verdict

    @property
    def right(self) -> bool:
        return self.verdict in ("effect", "ambiguous") and self.first in self.case.names

    @property
    def right_side(self) -> bool:
        """Whether the stage lies on the effect's side of the monitor."""
        put = self.case.puts[0]
        before = put["name"] in ("slew_limit", "rail_saturation") or put["where"] in ("command", "dac", "amplifier")
        stages = set(self.stage.split(" or "))
        return stages <= BEFORE_MONITOR if before else not stages & BEFORE_MONITOR

    @property
    def wrong(self) -> bool:
        """A name that is none of the case's, and no set that holds one of them."""
        return self.verdict in ("effect", "ambiguous") and not {self.first, *self.rivals} & set(self.case.names)


@dataclass
class Figure:
    """One row of the table. `target` reads as in the design; None: told, not judged."""

    name: str
    target: str
    value: float | None
    low: float | None
    high: float | None
    count: int
    met: bool | None


def judge(case: Case, verdict: dict[str, Any]) -> Judged:
    """What the tool said, from the verdict file."""
    gap = verdict.get("gap") or {}
    effects, candidates = gap.get("effects") or [], gap.get("candidates") or []
    accepted = tuple(effect["name"] for effect in effects)
    rivals = tuple(effects[0].get("confusable_with") or ()) if effects else ()
    by_shrink = [c["name"] for c in sorted(candidates, key=lambda c: -(c.get("shrink") or 0))]
    promised = gap.get("promised") or {}
    interval = promised.get("ci90")
    before, after = verdict.get("before_um"), verdict.get("after_um")
    return Judged(
        case=case, verdict=gap.get("verdict", "failed"), first=accepted[0] if accepted else "", rivals=rivals,
        ranked=tuple(dict.fromkeys([*accepted, *rivals, *by_shrink])), accepted=accepted,
        detection=float(gap.get("detection", np.nan)), promised=promised.get("shrink"),
        interval=tuple(interval) if interval and None not in interval else None,
        realised=1 - after / before if before and after is not None else None,
        dominant=(gap.get("where") or {}).get("dominant") or "", stage=(gap.get("where") or {}).get("stage") or "",
        seconds=verdict.get("seconds", np.nan))


def wilson(hits: int, count: int) -> tuple[float, float, float]:
    """Share and its 95 % interval after Wilson."""
    share = hits / count
    middle = (share + Z**2 / (2 * count)) / (1 + Z**2 / count)
    half = Z / (1 + Z**2 / count) * np.sqrt(share * (1 - share) / count + Z**2 / (4 * count**2))
    return share, float(max(0.0, middle - half)), float(min(1.0, middle + half))


def auc(positive: np.ndarray, negative: np.ndarray) -> float:
    """Probability that a positive scores above a negative, ties counting half."""
    return float(np.mean((positive[:, None] > negative) + 0.5 * (positive[:, None] == negative)))


def _bootstrap(statistic: Callable[..., float], *samples: np.ndarray) -> tuple[float, float, float]:
    random = np.random.default_rng(0)
    draws = [statistic(*(random.choice(sample, len(sample)) for sample in samples)) for _ in range(RESAMPLES)]
    low, high = np.percentile(draws, [2.5, 97.5])
    return statistic(*samples), float(low), float(high)


def _row(name: str, found: tuple[float, float, float] | None, count: int, least: float | None = None,
         most: float | None = None) -> Figure:
    target = "" if least is None and most is None else (
        f">= {least:g}" if most is None else f"<= {most:g}" if least is None else f"{least:g} to {most:g}")
    if found is None:
        return Figure(name, target, None, None, None, count, None)
    met = (least is None or found[0] >= least) and (most is None or found[0] <= most) if target else None
    return Figure(name, target, *found, count, met)


def _share(name: str, judged: Sequence[Judged], hit: Callable[[Judged], bool], least: float | None = None,
           most: float | None = None) -> Figure:
    found = wilson(sum(map(hit, judged)), len(judged)) if judged else None
    return _row(name, found, len(judged), least, most)


def figures(judged: Sequence[Judged]) -> list[Figure]:
    """The table of the design, in its order, then what it does not ask for."""
    def of(group: str, least_rho: float = 0.0, recordings: str = "") -> list[Judged]:
        """With an effect, only where the model misses more than without: some hide in what it missed anyway."""
        return [j for j in judged if j.case.group == group and j.case.reached >= least_rho
                and (least_rho == 0 or j.case.growth >= GREW) and recordings in ("", j.case.recordings)]

    def known(j: Judged) -> bool:
        return not np.isnan(j.detection)

    rows: list[Figure] = []
    none = of("none")
    if none:
        calm = np.array([j.detection for j in of("none", recordings="rich") if known(j)])
        for name, low, high, least in (("detection AUC, rho 1 to 3", 1, 3, 0.95),
                                       ("detection AUC, rho >= 3", 3, np.inf, 0.99)):
            hot = np.array([j.detection for j in of("single", low) if known(j) and j.case.reached < high])
            found = _bootstrap(auc, hot, calm) if len(hot) and len(calm) else None
            rows.append(_row(name, found, len(hot), least=least))
        poor = of("none", recordings="poor")
        rows += [_share("false alarms on 'none'", none, lambda j: j.verdict != "none", most=0.05),
                 _share("  of these on poor recordings", poor, lambda j: j.verdict != "none")]
    single = of("single", NAMEABLE)
    with_monitor = [j for j in single if j.case.monitor]
    if single:
        rows += [
            _share("right first name, rho >= 2", single, lambda j: j.right, least=0.80),
            _share("  of these with monitor", with_monitor, lambda j: j.right, least=0.90),
            _share("right group", single, lambda j: GROUP_OF.get(j.answer) == GROUP_OF[j.case.names[0]], least=0.90),
            _share("right in first two", single,
                   lambda j: j.verdict not in ("none", "failed") and j.case.names[0] in j.ranked[:2], least=0.92),
            _share("wrong name, rho >= 1", of("single", DETECTABLE), lambda j: j.wrong, most=0.08),
        ]
    small = [j for j in of("single") if SMALL <= j.case.reached < DETECTABLE]
    if small:
        rows += [_share("rho 0.2 to 1: detected", small, lambda j: j.verdict not in ("none", "failed")),
                 _share("rho 0.2 to 1: right first name", small, lambda j: j.right),
                 _share("rho 0.2 to 1: wrong name", small, lambda j: j.wrong)]
    foreign = of("foreign", NAMEABLE)
    if foreign:
        # a twin's name is as right as the catalogue allows, and counts on neither side
        strange = [j for j in foreign if j.answer not in TWINS.get(j.case.names[0], ())]
        rows += [_share("not in catalogue: said unknown, rho >= 2", strange, lambda j: j.verdict == "unknown",
                        least=0.80),
                 _share("not in catalogue: misnamed, rho >= 2", strange, lambda j: j.verdict == "effect", most=0.10)]
    pairs = of("pair", DETECTABLE)
    if pairs:
        rows += [_share("pairs: first name is one of them", pairs, lambda j: j.right, least=0.90),
                 _share("pairs: both in first three", pairs, lambda j: set(j.case.names) <= set(j.ranked[:3]),
                        least=0.60)]
    promised = [j for j in judged if j.case.group != "withheld" and j.case.names and j.accepted
                and j.promised is not None and j.realised is not None]
    if promised:
        errors = np.array([abs(j.promised - j.realised) for j in promised])
        rows.append(_row("promised - realised shrink, median error",
                         _bootstrap(lambda e: float(np.median(e)), errors), len(errors), most=0.05))
        stated = [j for j in promised if j.interval is not None]
        rows.append(_share("  its 90 % interval covers", stated,
                           lambda j: j.interval[0] <= j.realised <= j.interval[1], least=0.85, most=0.95))
    poor = of("poor", DETECTABLE)
    if poor:
        rows.append(_share("poor recordings: wrong name, rho >= 1", poor, lambda j: j.wrong, most=0.05))
    born = of("born in", DETECTABLE)
    if born:
        rows += [_share("born in: right first name", born, lambda j: j.right),
                 _share("born in: said none", born, lambda j: j.verdict == "none"),
                 _share("born in: wrong name", born, lambda j: j.wrong)]
    withheld = of("withheld", NAMEABLE)
    if withheld:
        rows += [_share("withheld: said unknown", withheld, lambda j: j.verdict == "unknown"),
                 _share("withheld: named a twin", withheld, lambda j: j.answer in TWINS.get(j.case.names[0], ())),
                 _share("withheld: said none", withheld, lambda j: j.verdict == "none"),
                 _share("withheld: misnamed", withheld, lambda j: j.verdict in ("effect", "ambiguous")
                        and j.answer not in TWINS.get(j.case.names[0], ()))]
    measured = of("measured", 1e-9)
    if measured:
        larger = [j for j in measured if j.case.kind != "small"]
        rows += [_share("measured: right name or set, not the smallest", larger,
                        lambda j: not j.wrong and j.verdict in ("effect", "ambiguous"), least=0.85),
                 _share("measured: wrong name", measured, lambda j: j.wrong)]
    located = withheld or single
    if located:
        rows += [_share("dominant axis as expected", located, lambda j: j.dominant in WHERE[j.case.names[0]]),
                 _share("right side of the monitor", [j for j in located if j.case.monitor], lambda j: j.right_side)]
    rows.append(_share("failed", judged, lambda j: j.verdict == "failed", most=0.0))
    time = np.array([j.seconds / j.case.samples * 1e5 for j in judged if j.seconds > 0])
    if len(time):
        rows.append(_row("s per 100 000 samples, one core, median",
                         _bootstrap(lambda t: float(np.median(t)), time), len(time)))
    return rows


def table(rows: Iterable[Figure]) -> str:
    lines = [f"{'figure':<44}{'target':>12}{'found':>8}  {'95 % interval':<16}{'cases':>6}"]
    for row in rows:
        found = "-" if row.value is None else f"{row.value:.3f}"
        interval = "" if row.value is None else f"{row.low:.3f} .. {row.high:.3f}"
        said = {True: "met", False: "NOT MET", None: ""}[row.met]
        lines.append(f"{row.name:<44}{row.target:>12}{found:>8}  {interval:<16}{row.count:>6}  {said}".rstrip())
    return "\n".join(lines)


def per_effect(judged: Sequence[Judged]) -> str:
    """One line per group, effect and severity asked for: cases, and how many times which answer."""
    groups: dict[tuple[str, str, float], list[Judged]] = {}
    for j in judged:
        groups.setdefault((j.case.group, " + ".join(j.case.names), j.case.rho), []).append(j)
    lines = [f"{'group':<10}{'effect':<42}{'rho':>5}{'got':>7}{'grew':>6}  right/cases  answers"]
    for (group, name, rho), found in sorted(groups.items()):
        answers = Counter(j.answer + ("?" if j.verdict == "ambiguous" else "") for j in found)
        if group == "none":
            right = sum(j.verdict == "none" for j in found)
        else:
            right = sum(j.verdict == "unknown" if group in ("foreign", "withheld") else j.right for j in found)
        got, grew = (np.mean([getattr(j.case, key) for j in found]) for key in ("reached", "growth"))
        said = ", ".join(f"{answer} {n}" for answer, n in answers.most_common())
        share = f"{right}/{len(found)}"
        lines.append(f"{group:<10}{name:<42}{rho:>5g}{got:>7.2f}{grew:>6.2f}  {share:>11}  {said}")
    return "\n".join(lines)


def confusion(judged: Sequence[Judged]) -> tuple[list[str], list[str], np.ndarray]:
    """Row names, column names and counts: truth against answer, rho >= 2 and 'none', rich recordings."""
    columns = [*IN_CATALOGUE, "unknown", "none", "failed"]
    used = [j for j in judged if j.case.group == "none" or j.case.group in ("single", "foreign", "withheld", "measured")
            and j.case.reached >= NAMEABLE and j.case.growth >= GREW]
    truth = [j.case.names[0] if j.case.names else "none" for j in used]
    rows = [name for name in (*IN_CATALOGUE, *sorted(set(truth) - set(IN_CATALOGUE))) if name in truth]
    counts = np.zeros((len(rows), len(columns)), dtype=int)
    for name, j in zip(truth, used):
        counts[rows.index(name), columns.index(j.answer if j.answer in columns else "unknown")] += 1
    return rows, columns, counts


def matrix_text(rows: Sequence[str], columns: Sequence[str], counts: np.ndarray) -> str:
    lines = ["".join([f"{'truth, then answer':<22}", *(f"{name[:7]:>8}" for name in columns)])]
    for name, line in zip(rows, counts):
        lines.append("".join([f"{name:<22}", *(f"{n or '.':>8}" for n in line)]))
    return "\n".join(lines)


def draw_matrix(path: Path, rows: Sequence[str], columns: Sequence[str], counts: np.ndarray) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Picture

    picture = Picture(figsize=(1 + 0.5 * len(columns), 2 + 0.36 * len(rows)), layout="constrained")
    FigureCanvasAgg(picture)
    axes = picture.add_subplot()
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha="right")
    axes.set_yticks(range(len(rows)), rows)
    for (i, k), n in np.ndenumerate(counts):
        if n:
            axes.text(k, i, str(n), ha="center", va="center", color="white" if shares[i, k] > 0.5 else "black")
    axes.set_xlabel("first name, or verdict")
    axes.set_ylabel("effect in the data")
    axes.set_title("cases with rho of 2 or more, and those without effect")
    picture.savefig(path, dpi=110)


def results(judged: Sequence[Judged], rows: Sequence[Figure]) -> dict[str, Any]:
    """For results.json: the figures, the confusion matrix, every case with label and verdict."""
    names, columns, counts = confusion(judged)
    return {"figures": [asdict(row) for row in rows],
            "confusion": {"rows": names, "columns": columns, "counts": counts.tolist()},
            "cases": [{**asdict(j), "right": j.right, "wrong": j.wrong} for j in judged]}
