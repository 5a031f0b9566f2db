"""Cases of the withheld-effect check: what is put into which machine, how strongly, and the files that come of it.

A severity rho is the rms of what the effect changes, each run's mean removed, over the rms of what the model misses on
the same runs without the effect. The labels stay in memory until `write_labels` seals them.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass, field, replace
from io import StringIO
from itertools import cycle, islice
from pathlib import Path

import numpy as np
from actuators import (EFFECTS, FORMS, IN_CATALOGUE, OUT_OF_CATALOGUE, POOR, RICH, Form, Put, Run, make_machine,
                       make_run, record, simulate)
from rdpi.cli import program as cli
from rdpi.data import Recording, write_recording
from rdpi.model import Model, read_model
from rdpi.simulate import chain

RHOS = (4.0, 1.0, 10.0, 2.0, 0.3)  # small sets get the first of them
PAIRED_RHOS = (1.0, 0.3, 4.0, 0.5, 0.2)  # with earlier recordings smaller changes show
CASES_PER_MACHINE, LEAST_MACHINES = 20, 8
SHARES = {"single": 0.40, "born in": 0.06, "foreign": 0.09, "pair": 0.06, "poor": 0.055}  # the rest is "none"
# The fit takes up the others, entirely or so far that nothing is left to be found.
BORN_IN = ("delay", "lag", "slew_limit", "rail_saturation", "quantisation", "creep", "static_nonlinearity",
           "thermal_drift", "resonance", "backlash", "periodic_disturbance", "cross_coupling", "rate_dependence")
GROUPS = {  # by what their residual looks like
    "timing": ("delay", "lag", "slew_limit", "resonance"),
    "curve": ("gain_change", "static_nonlinearity", "rail_saturation"),
    "loop": ("hysteresis_change", "rate_dependence", "backlash", "initial_memory"),
    "slow": ("creep", "thermal_drift"),
    "grid": ("quantisation",),
    "disturbance": ("periodic_disturbance", "cross_coupling"),
}
GROUP_OF = {name: group for group, names in GROUPS.items() for name in names}
SEARCHES = 14  # steps of the search for a size
CLOSE = 1.06  # the rms found lies between the one sought and this times it


@dataclass
class Case:
    """What is asked, and after generation what the answer is."""

    group: str  # key of SHARES, "none", "withheld" or "measured"
    names: tuple[str, ...]
    rho: float
    machine: int
    recordings: str = "rich"
    ident: str = ""
    kind: str = ""
    monitor: bool = False
    rate_law: bool = False
    puts: list[dict] = field(default_factory=list)
    reached: float = 0.0  # rho of the effect, of the weaker one in a pair
    growth: float = 1.0  # residual with the effect over that without
    absorbed: float = 0.0  # born in: share of the effect's rms that the fit took up
    floor_um: float = 0.0
    samples: int = 0


def plan(count: int, seed: int, withhold: str | None, paired: bool = False) -> list[Case]:
    """The cases, spread evenly over effects, severities and machines. With `withhold`, that effect alone, or "all"."""
    random = np.random.default_rng([seed, 1])
    machines = min(count, max(LEAST_MACHINES, -(-count // CASES_PER_MACHINE)))

    def spread(names: Sequence[str], rhos: Sequence[float], amount: int) -> list[tuple[str, float]]:
        shuffled = random.permutation(names).tolist()
        return list(islice(cycle((name, rho) for rho in rhos for name in shuffled), amount))

    catalogue, rhos, strong = list(IN_CATALOGUE), PAIRED_RHOS if paired else RHOS, RHOS[:-1]
    cases: list[Case] = []
    if withhold:
        names = catalogue if withhold == "all" else [withhold]
        cases += [Case("withheld", (name,), rho, 0) for name, rho in spread(names, (4.0, 10.0, 2.0), count)]
    else:
        amounts = {group: int(share * count) for group, share in SHARES.items()}
        cases += [Case("none", (), 0.0, 0, "poor" if k % 5 == 4 else "rich")
                  for k in range(count - sum(amounts.values()))]
        cases += [Case("single", (name,), rho, 0) for name, rho in spread(catalogue, rhos, amounts["single"])]
        cases += [Case("born in", (name,), rho, 0) for name, rho in spread(BORN_IN, strong, amounts["born in"])]
        cases += [Case("foreign", (name,), rho, 0)
                  for name, rho in spread(list(OUT_OF_CATALOGUE), strong, amounts["foreign"])]
        cases += [Case("poor", (name,), rho, 0, "poor") for name, rho in spread(catalogue, strong, amounts["poor"])]
        for k in range(amounts["pair"]):
            first, second = random.choice(list(GROUPS), 2, replace=False)
            cases.append(Case("pair", (str(random.choice(GROUPS[first])), str(random.choice(GROUPS[second]))),
                              (4.0, 2.0)[k % 2], 0))
    for k, index in enumerate(random.permutation(len(cases))):
        cases[index].machine = k % machines
        cases[index].ident = random.bytes(6).hex()
    return cases


class Bench:
    """One machine, its model, and runs that its cases share."""

    def __init__(self, folder: Path, form: Form, seed: int, index: int, paired: bool = False) -> None:
        """With `paired`, every drive is recorded twice: before, and with what is put in."""
        self.folder, self.form, self.paired = folder, form, paired
        self.random = np.random.default_rng([seed, 2, index])
        self.machine = make_machine(form, index, self.random)
        self.name = self.random.bytes(6).hex()
        self.commissioning = self.runs((*RICH, "track"))
        self.pools: dict[tuple[str, bool], list[Run]] = {}
        self.model = self.fit((), self.name)

    def runs(self, kinds: Sequence[str], swept: float = 1.0) -> list[Run]:
        """Fresh runs, of which a share is swept beforehand."""
        return [make_run(kind, self.machine, self.form, int(self.random.integers(2**62)),
                         bool(self.random.random() < swept)) for kind in kinds]

    def pool(self, recordings: str, swept: bool) -> list[Run]:
        if (recordings, swept) not in self.pools:
            kinds = RICH if recordings == "rich" else POOR
            self.pools[recordings, swept] = self.runs(kinds, 1.0 if swept else 0.7)
        return self.pools[recordings, swept]

    def recordings(self, runs: Sequence[Run], puts: Sequence[Put]) -> list[Recording]:
        """With fresh noise."""
        metadata = {"actuator": self.name, "sample_rate_hz": f"{self.machine.sample_rate_hz:g}"}
        return [Recording(run.kind, metadata | {"memory": "reset" if run.reset else "unknown"},
                          record(self.machine, run, puts, int(self.random.integers(2**62)))) for run in runs]

    def fit(self, puts: Sequence[Put], name: str) -> Model:
        """Identify from files with `rdpi fit`, and leave the model beside them."""
        folder = self.folder / "models" / name
        # A recording in which an effect born in drowns the movement is left out, as fit would ask for.
        made = [run for run in self.recordings(self.commissioning, puts)
                if abs(np.corrcoef(run.command_V, run.displacement_um)[0, 1]) > 0.55]
        paths = write(folder, "fit", made)
        path = str(folder / "model.json")
        options = ["--rate-independent"] if self.machine.rate_law == 0 else []
        # what fit says when a saturation stage makes no sense of the data: fewer dead zones
        if all(rdpi("fit", *paths, "-o", path, "--deadzones", str(count), *options) for count in (2, 1, 0)):
            raise SystemExit(f"{folder}: rdpi fit refuses these recordings")
        return read_model(path)

    def make(self, case: Case) -> None:
        """Write the case's files and complete its label."""
        machine = self.machine
        case.kind, case.monitor, case.rate_law = machine.kind, machine.monitor, machine.rate_law > 0
        kinds = RICH if case.recordings == "rich" else POOR
        if case.group == "none":
            runs = self.runs(kinds, 0.7)
        else:
            runs = self.pool(case.recordings, "initial_memory" in case.names)
        case.floor_um = residual_rms(self.model, self.recordings(runs, ()))
        puts, case.reached = [], np.inf if case.names else 0.0
        for name in case.names:
            put, rms = self.sized(name, runs, case.rho * case.floor_um)
            puts.append(put)
            case.reached = min(case.reached, rms / case.floor_um)
        case.puts = [put._asdict() for put in puts]
        recordings = self.recordings(runs, puts)
        case.samples = sum(map(len, recordings))
        model, model_name = self.model, self.name
        if case.group == "born in":
            model_name = self.random.bytes(6).hex()
            model = self.fit(puts, model_name)
        if case.names:
            case.growth = residual_rms(model, recordings) / case.floor_um
        if case.group == "born in":
            left = np.sqrt(max(0.0, case.growth**2 - 1)) / case.reached
            case.absorbed = float(1 - min(1.0, left))
        folder = self.folder / "cases" / case.ident
        write(folder, "run", recordings)
        if self.paired:
            write(folder, "earlier", self.recordings([self.once_more(run) for run in runs],
                                                     puts if case.group == "born in" else ()))
        else:
            write(folder, "later", self.recordings(self.runs(kinds), puts))
        task = {"model": f"../../models/{model_name}/model.json",
                "without": list(case.names) if case.group == "withheld" else []}
        (folder / "task.json").write_text(json.dumps(task))

    def once_more(self, run: Run) -> Run:
        """The same drive, from another past unless it was swept."""
        return run if run.reset else replace(run, past_V=self.random.permutation(run.past_V), cache={})

    def sized(self, name: str, runs: Sequence[Run], target_um: float) -> tuple[Put, float]:
        """The effect at the size whose rms in um is the target's, or at its largest; and that rms."""
        where, form = str(self.random.choice(EFFECTS[name].places)), float(self.random.random())
        plain = [simulate(self.machine, run)[1] for run in runs]

        def rms(size: float) -> float:
            changed = [simulate(self.machine, run, [Put(name, size, where, form)])[1] for run in runs]
            return pooled([a - b for a, b in zip(changed, plain)])

        size, reached = find_size(rms, target_um, EFFECTS[name].largest)
        return Put(name, size, where, form), reached


def rdpi(*arguments: str) -> str:
    """Run a command of rdpi in this process, what it prints dropped; returns why it failed, or nothing."""
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as errors:
        status = cli.main(list(arguments), standalone_mode=False)
    return f"exit status {status}: {errors.getvalue()}" if status else ""


def find_size(rms: Callable[[float], float], target: float, largest: float) -> tuple[float, float]:
    """Size at which a growing function lies from the target up to CLOSE times it; `largest` if it stays below."""
    low, high, size = 0.0, largest, largest / 20
    best = (largest, rms(largest))
    if best[1] <= target * CLOSE:
        return best
    for _ in range(SEARCHES):
        value = rms(size)
        if target <= value:
            high, best = size, (size, value)
            if value <= target * CLOSE:
                break
        else:
            low = size
        # in proportion, as long as that stays between what is too small and what is too large
        guess = size * target * (1 + CLOSE) / 2 / value if value > 0 else high
        size = guess if low < guess < high else (np.sqrt(low * high) if low > 0 else high / 10)
    return best


def pooled(differences: Sequence[np.ndarray]) -> float:
    """Root mean square over all samples, each run's mean removed."""
    squares = sum(float(np.sum((d - np.mean(d)) ** 2)) for d in differences)
    return float(np.sqrt(squares / sum(map(len, differences))))


def residual_rms(model: Model, recordings: Sequence[Recording]) -> float:
    predictions = chain.simulate(model, recordings)
    return pooled([run.displacement_um - found.predicted_um for run, found in zip(recordings, predictions)])


def write(folder: Path, stem: str, recordings: Sequence[Recording]) -> list[str]:
    folder.mkdir(parents=True, exist_ok=True)
    paths = [str(folder / f"{stem}-{number}.csv") for number in range(1, len(recordings) + 1)]
    for path, run in zip(paths, recordings):
        write_recording(path, run.columns, run.metadata)
    return paths


def generate(folder: Path, form: str, seed: int, paired: bool, cases: list[Case]) -> list[Case]:
    """All cases of one machine; returns them with their labels complete."""
    bench = Bench(folder, FORMS[form], seed, cases[0].machine, paired)
    for case in cases:
        bench.make(case)
    return cases


def write_labels(path: Path, cases: Sequence[Case]) -> str:
    """Seal the labels: packed, so that no search over the folder stumbles on them. Returns their digest."""
    data = zlib.compress(json.dumps([asdict(case) for case in cases]).encode())
    path.write_bytes(data)
    return hashlib.sha256(data).hexdigest()


def read_labels(path: Path, digest: str) -> list[Case]:
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != digest:
        raise SystemExit(f"{path}: not the labels that were sealed; generate the set again")
    return [Case(**{**label, "names": tuple(label["names"])}) for label in json.loads(zlib.decompress(data))]
