"""The document of `rdpi gap --json`, section by section; the folder of --report holds the same as gap.json."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from ..identify import AxisEntry, BeforeAfter
from ..model import Document, json_key, records
from . import thresholds

Interval = tuple[float, float]
Verdict = Literal["effect", "ambiguous", "none", "unknown"]


@dataclass(kw_only=True)
class AcceptedEffect(Document):
    """An effect that was accepted, as judged in its round."""

    name: str = json_key("name of the effect")
    stage: str = json_key("stage of the chain at which it acts")
    column: str | None = json_key("column of the recordings that it follows", omitted=True)
    parameters: dict[str, records.EffectParameter] = json_key("parameters by name")
    was: dict[str, float | None] | None = json_key(
        "of an effect that the model holds already and that has changed: values in the model that was given, by name",
        omitted=True)
    held_out_rms_um: BeforeAfter = json_key("residual of recordings, or parts of them, that it was not fitted to",
                                            "um")
    shrink: float = json_key("share by which it shrinks that residual's rms", high=1)
    shrink_ci95: Interval | None = json_key("95 % interval of shrink; null: one recording only", high=1)
    confidence: float = json_key("weight of this effect among those tried, by the squares they leave", low=0, high=1)
    confusable_with: list[str] = json_key("names of effects that explain these recordings as well")


@dataclass(kw_only=True)
class CandidateEntry(Document):
    """An effect that was tried, or why it was not."""

    name: str = json_key("name of the effect")
    stage: str = json_key("stage at which it explains most")
    shrink: float = json_key("share by which it shrinks the rms of recordings it was not fitted to, the model as it is",
                             high=1)
    shrink_ci95: Interval | None = json_key("95 % interval of shrink; null: one recording only, or not tried", high=1)
    refitted_shrink: float = json_key("share by which it shrinks that rms beyond what fitting the model anew brings",
                                      high=1)
    parameters: dict[str, records.EffectParameter] = json_key("parameters by name")
    was: dict[str, float | None] | None = json_key(
        "of an effect that the model holds already, and that was asked whether it has changed: values in the model, by "
        "name", omitted=True)
    excited: bool = json_key("true: these recordings can show it, and it was tried")
    share_of_excess: float | None = json_key("share that it explains of the squares beyond the passport", omitted=True)
    rejected_because: str | None = json_key("why it was not accepted; null: it was accepted, or explains as much")


@dataclass(kw_only=True)
class GapFigures(Document):
    """How large the gap is."""

    rms_um: float = json_key("rms of measured minus predicted, means removed", "um", low=0)
    percent_of_stroke: float = json_key("the same, of the largest stroke of the recordings", "%", low=0)
    noise_floor_um: float = json_key("rms of the sensor's noise", "um", low=0)
    explained_um: float = json_key("rms of what the accepted effects explain", "um", low=0)
    remaining_um: float = json_key("rms with the accepted effects", "um", low=0)
    whole_um: BeforeAfter | None = json_key("with --earlier, rms of all that the model misses, not only of what has "
                                            "changed; else null", "um", default=None)


@dataclass(kw_only=True)
class StageShares(Document):
    """Shares of the gap's energy on both sides of monitor_V."""

    before_monitor: float = json_key("numerics, DAC, timing, amplifier", low=0, high=1)
    after_monitor: float = json_key("actuator, mechanics, environment, sensor", low=0, high=1)


@dataclass(kw_only=True)
class Where(Document):
    """Where the gap lies."""

    stage: str = json_key("stage of the chain, as far as it is known")
    stages: StageShares | None = json_key("shares before and after monitor_V; null: not recorded")
    runs: list[str] = json_key("paths of the recordings, the largest share of the gap first")
    axes: dict[str, AxisEntry] = json_key("the gap along time_s, frequency_hz, rate_um_per_s, position_um, direction, "
                                          "since_reversal_s, amplitude_um and recording")
    dominant: str = json_key("the axis that concentrates the gap most")


@dataclass(kw_only=True)
class RunEntry(Document):
    """One recording."""

    file: str = json_key("path as given")
    digest: str = json_key("SHA-256 of the file")
    samples: int = json_key("number of samples", low=0)
    earlier: str | None = json_key("path of the earlier recording of the same drive; null: none was given",
                                   default=None)
    rms_um: BeforeAfter = json_key("rms of its gap", "um")
    offset_um: float = json_key("mean of measured minus predicted, which rms_um leaves out", "um")
    noise_floor_um: float = json_key("rms of the sensor's noise", "um", low=0)
    percent_of_stroke: float = json_key("rms without the effects, of the recording's stroke", "%", low=0)
    ratio: float | None = json_key("rms without the effects over the one that the passport expects; null: no passport",
                                   low=0)
    share: float = json_key("share of the gap's energy", low=0)


@dataclass(kw_only=True)
class PassportFigures(Document):
    """The gap against the model's passport."""

    ratio: float = json_key("rms of the gap over the one that the passport expects", low=0)
    rms_um: float = json_key("rms that the passport expects", "um", low=0)
    held_out: records.HeldOut = json_key("how the passport's recordings were predicted")
    spread: float = json_key("standard deviation of the logarithm of ratio when nothing is wrong", low=0)


@dataclass(kw_only=True)
class TrackingPromise(Document):
    """What compensating the effects promises for the tracking error, that of a constant apart."""

    shrink: float = json_key("share by which its rms shrinks, over all references together", high=1)
    ci90: Interval | None = json_key("90 % interval of shrink; null: one recording only", high=1)


@dataclass(kw_only=True)
class Promise(Document):
    """What adding the effects to the model promises on new recordings."""

    shrink: float | None = json_key("share by which the gap's rms shrinks; null: no effect was accepted", high=1)
    ci90: Interval | None = json_key("90 % interval of shrink; null: see why_no_interval", high=1)
    why_no_interval: str | None = json_key("why ci90 is null; null: it is not")
    tracking: TrackingPromise | None = json_key(
        "what the inverse of the improved model promises beside that of the given one, for the references of "
        "--reference; all that the model misses counts, with --earlier too; without the key, no reference was given, "
        "no effect was accepted, or a model has no inverse (a note says why)", omitted=True)


@dataclass(kw_only=True)
class Refit(Document):
    """What fitting the model anew would bring, without any effect."""

    shrink: float = json_key("share by which the gap's rms would shrink", high=1)


@dataclass(kw_only=True)
class Numerics(Document):
    """What the firmware's arithmetic adds."""

    engine: str = json_key("what is compared with what")
    rms_um: dict[str, float | None] = json_key("rms by engine, at the recorded sample rate; null: the engine refuses "
                                               "the model", "um", low=0)
    rms_um_4x: dict[str, float | None] | None = json_key("the same at four times the sample rate", "um", low=0,
                                                         omitted=True)


@dataclass(kw_only=True)
class NotExcited(Document):
    """An effect that these recordings cannot show."""

    name: str = json_key("name of the effect")
    needs: str = json_key("what recordings must hold to show it")


@dataclass(kw_only=True)
class NotKnown(Document):
    """A part of the gap that lies where the recordings of the passport hardly moved: it need not be new."""

    axis: Literal["frequency_hz", "position_um", "movement_um"] = json_key(
        "axis on which it lies; movement_um: standard deviation of a recording's prediction")
    low: float = json_key("where it begins")
    high: float = json_key("where it ends")
    unit: str = json_key("unit of low and high")
    share: float = json_key("share of the gap's energy beyond noise", low=0, high=1)
    moved_um: float | None = json_key("how far the recordings move there; null: along position", "um", low=0,
                                      default=None)
    commissioned_um: float | None = json_key("how far those of the passport did; null: along position", "um", low=0,
                                             default=None)


@dataclass(kw_only=True)
class Leftover(Document):
    """What is left with the effects."""

    ratio: float | None = json_key("its rms over the one that the passport expects; null: no passport", low=0)
    correlation: dict[str, float] = json_key("correlation with command, command_squared, rate and direction")
    kurtosis: float | None = json_key("kurtosis; 3: normal; null: nothing is left", low=0)


@dataclass(kw_only=True)
class Matrix(Document):
    """Which effects these recordings can tell apart."""

    names: list[str] = json_key("effects, the one that explains most first")
    r2: list[list[float | None]] = json_key("R²: share of the signature of the row's effect that the column's "
                                            "reproduces; null: it shows nothing here")


@dataclass(kw_only=True)
class NextExperiment(Document):
    """A recording that would settle what is open."""

    command: str = json_key("command that makes the drive")
    why: str = json_key("what it would show")
    seconds: float | None = json_key("length of the drive; null: not known", "s", low=0)


@dataclass(kw_only=True)
class Offset(Document):
    """Means of measured minus predicted, which no other figure counts."""

    mean: float = json_key("mean over the recordings", "um")
    low: float = json_key("lowest of a recording", "um")
    high: float = json_key("highest of a recording", "um")
    added: float = json_key("what the improved model's offset_um has more; 0: the recordings do not agree that the "
                            "zero moved", "um")
    moved: bool = json_key("true: the recordings agree, and each is so far off, with the effects and without, that "
                           "the sensor's zero, or the mount, has changed")


@dataclass(kw_only=True)
class GapDocument(Document):
    """What `rdpi gap` found."""

    SCHEMA: ClassVar[str] = "rdpi-gap/1"

    tool: str = json_key("version of rdpi that wrote the document")
    verdict: Verdict = json_key("effect: the accepted ones explain the gap; ambiguous: others explain it as well; "
                                "none: nothing is new; unknown: no known effect explains it")
    detection: float = json_key("evidence for a gap: the larger, the surer")
    paired: bool = json_key("true: with --earlier, the gap is what has changed since", default=False)
    effects: list[AcceptedEffect] = json_key("accepted effects, in the order added")
    candidates: list[CandidateEntry] = json_key("every effect that is known")
    gap: GapFigures = json_key("how large the gap is")
    where: Where = json_key("where the gap lies")
    runs: list[RunEntry] = json_key("the recordings")
    passport: PassportFigures | None = json_key("the gap against the model's passport; null: the model has none")
    promised: Promise = json_key("what adding the effects promises on new recordings")
    refit: Refit = json_key("what fitting the model anew would bring")
    numerics: Numerics | None = json_key("what the firmware's arithmetic adds; null: it refuses the model")
    not_excited: list[NotExcited] = json_key("effects that these recordings cannot show")
    not_known_from_commissioning: list[NotKnown] = json_key(
        "parts of the gap that lie where the recordings of the passport hardly moved: they need not be new",
        default_factory=list)
    stuck: float = json_key("share of the gap's energy where readings stand still before they catch up in a jump; 0: they "
                            "did at commissioning as well", low=0, high=1, default=0.0)
    leftover: Leftover | None = json_key("what is left with the effects", default=None)
    matrix: Matrix = json_key("which effects these recordings can tell apart")
    next_experiment: NextExperiment | None = json_key("the recording to make next; null: none would settle anything")
    notes: list[str] = json_key("remarks of the diagnosis")
    offset_um: Offset = json_key("means that no other figure counts", "um")
    gate_failed: bool = json_key("true: the verdict is one of --fail-on, or the gap exceeds --max-gap", default=False)
    model: str | None = json_key("path of the model file", omitted=True)
    model_digest: str | None = json_key("SHA-256 of what the firmware takes from the model", omitted=True)

    @property
    def sticks(self) -> bool:
        """Whether readings that stand still may be why the gap has no name."""
        return self.verdict == "unknown" and self.stuck > thresholds.STUCK
