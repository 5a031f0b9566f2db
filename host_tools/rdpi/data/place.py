"""Where a drive lies in a recording, to parts of a sample, and how surely, from the samples as recorded.

A converter holds each sample of the drive, and passes from one to the next within an unknown share of a sample: at once
(a staircase), or over the whole sample (a straight line). For each share, and for each shift of the drive, the squares
are summed that gain · drive + offset leaves. All places that fit as well as noise allows make a region. The place is its
middle, the doubt half its width: where a scope sees each sample once, the region is all of the hold.

Shifts are searched on a grid that becomes finer. Between two of its nodes lies a better place perhaps; by how much
better, the drive's steps tell, so no region is lost.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

EDGES = 0.0, 0.3, 1.0  # of a sample, that passing to the next may take; or as long as the scope averages
NODES = 25, 97  # of the grid, for each of two unknowns, at first and at most
BLOCKS = 48  # of the recording, in each of which the drive is shifted as a whole
SIGMAS = 3.0  # standard errors that the region holds
FIRST, WIDEST = 2.0, 16.0  # samples of the drive: half of the grid at first, and at most
FINEST = 1 / 500  # samples of the drive: nodes as close as this need not be closer
RESOLVED = 0.25  # of what noise allows: what two nodes differ by
SHRINKS = 0.8  # a grid that shrinks by less is the last
# A doubt that is NARROW (samples of the drive) comes from the grid rather than from noise: only nodes count then, but
# also those that fit worse by SURELY times what noise allows.
NARROW, SURELY = (0.5, 1.5), 5 / 3
MAINS_HZ = 50.0, 60.0
HUMS, LEAST_HUM = 4, 0.05  # rounds of fitting hum, at most; samples of the drive by which hum may move it
LEAST_NOISE = 3e-4  # of the recorded rms: 12 bits; less noise than that would make any grid seem too coarse
LEVELS = 30  # grids, at most
SAMPLES, MOST_SAMPLES = 20_000, 160_000  # of the recording; the latter while the doubt is between ENOUGH and HOPELESS
LEAST_WORTH = 0.2  # of the mean movement: what a sample is worth where the drive stands still
ENOUGH, HOPELESS = 0.25, 3.0  # samples of the drive


class Place(NamedTuple):
    """How much later than supposed a drive is, in its samples, and how well it fits there."""

    first: float  # shift at the drive's first sample
    last: float  # and at its last
    doubt: float  # half the region's width, at the sample asked for or where the drive moves last; inf: beyond the grid
    gain: float
    offset_V: float
    noise: float  # rms that is left, of the drive's


def place(heard_V: np.ndarray, at: np.ndarray, drive_V: np.ndarray, needed: int, averaged: float, step_s: float
          ) -> Place:
    """The place of a drive in the samples `heard_V`, which are supposed to lie at its indices `at`.

    The doubt is that from index `needed` of the drive on, as long as it moves: in a hold at its end a wrong place shifts
    nothing. `averaged` is the recording's sample time in samples of the drive: a scope may give means over it. The
    recording's clock counts `step_s` for a sample of the drive. Hum is taken off where it moves the place.
    """
    for _ in range(HUMS):
        found = _placed(heard_V, at, drive_V, needed, averaged)
        hum_V, moves = _hum(heard_V, at, drive_V, found, needed, step_s)
        if not np.isfinite(found.doubt) or moves <= LEAST_HUM:
            break
        heard_V = heard_V - hum_V
    return found._replace(doubt=found.doubt + moves)


def _hum(heard_V: np.ndarray, at: np.ndarray, drive_V: np.ndarray, found: Place, needed: int, step_s: float
         ) -> tuple[np.ndarray, float]:
    """What the mains adds to a recording, and by how many samples the drive moves if that is fitted too.

    A drive may hold a line at the very frequency; a hum then looks like a shift of that line.
    """
    inside = np.flatnonzero((at >= 0) & (at <= len(drive_V) - 1))
    last, x = len(drive_V) - 1, at / (len(drive_V) - 1)
    here, index = x[inside], np.arange(len(drive_V))
    placed = at[inside] - found.first - (found.last - found.first) * here
    slope = np.interp(placed, index, np.gradient(drive_V))
    phase = 2 * np.pi * step_s * np.outer(MAINS_HZ, np.where(np.isfinite(at), at, 0.0))
    mains = np.concatenate([np.sin(phase), np.cos(phase)])
    parts = np.stack([np.interp(placed, index, drive_V), np.ones_like(here), slope, slope * here, *mains[:, inside]])
    normal, says = parts @ parts.T, parts @ heard_V[inside]
    without, hummed = (np.linalg.lstsq(normal[:many, :many], says[:many], rcond=None)[0] for many in (4, len(parts)))
    ends = np.array([needed / last, 1.0])
    moved = [(fit[2] + fit[3] * ends) / (fit[0] or np.inf) for fit in (without, hummed)]
    return hummed[4:] @ mains, float(np.max(np.abs(moved[1] - moved[0])))


def _placed(heard_V: np.ndarray, at: np.ndarray, drive_V: np.ndarray, needed: int, averaged: float) -> Place:
    inside = (at >= FIRST) & (at <= len(drive_V) - 1 - FIRST)
    heard_V, at = heard_V[inside], at[inside]
    moves = np.abs(np.diff(drive_V))[np.clip(np.floor(at).astype(np.intp), 0, len(drive_V) - 2)]
    worth, most = moves + LEAST_WORTH * np.mean(moves), SAMPLES
    while True:
        # By chance: every n-th sample may see the same part of each hold. Where the drive moves, they tell more.
        taken = np.random.default_rng(0).random(len(at)) * np.sum(worth) < most * worth
        found = _Search(heard_V[taken], at[taken], drive_V, needed, averaged).run()
        if most >= min(MOST_SAMPLES, len(at)) or not ENOUGH < found.doubt < HOPELESS:
            return found
        most = MOST_SAMPLES


class _Search:
    """Two unknowns: `shift` where the drive moves on average, and `stretch` from its first sample to its last."""

    def __init__(self, heard_V: np.ndarray, at: np.ndarray, drive_V: np.ndarray, needed: int, averaged: float) -> None:
        self.mean_V = float(np.mean(drive_V)), float(np.mean(heard_V))
        self.drive, self.heard, self.at = drive_V - self.mean_V[0], heard_V - self.mean_V[1], at
        self.sums = np.concatenate([[0.0], np.cumsum(self.drive)])
        self.edges = sorted({*EDGES, max(1.0, averaged)})
        self.steps = np.diff(self.drive)[np.clip(np.floor(at).astype(np.intp), 0, len(drive_V) - 2)] ** 2
        last = len(drive_V) - 1
        middle = float(np.average(at, weights=self.steps)) if self.steps.any() else last / 2
        self.x = (at - middle) / last
        moves = float(np.flatnonzero(np.diff(drive_V))[-1] + 1)
        self.needed = (needed - middle) / last, (max(moves, needed) - middle) / last
        self.ends = -middle / last, (last - middle) / last
        self.starts = np.linspace(0, len(at), min(BLOCKS, len(at)) + 1).astype(np.intp)[:-1]
        self.block_x = np.add.reduceat(self.x, self.starts) / np.diff(self.starts, append=len(at))

    def run(self) -> Place:
        centre, half, nodes, coloured, rounds = np.zeros(2), np.array([FIRST, FIRST]), NODES[0], 1.0, 0
        for _ in range(LEVELS):
            grid = self._grid(centre, half, nodes)
            node = 2 * half / (nodes - 1)
            noise2 = max(grid.least / max(len(self.at) - 5, 1), (LEAST_NOISE * float(np.std(self.heard))) ** 2)
            allowed = SIGMAS * np.sqrt(noise2 * coloured)
            between = abs(grid.gain) * np.array([self._differs(edge, node / 2) for edge in self.edges])
            region = (grid.squares <= grid.least + (between[:, None, None] + allowed) ** 2).any(0)
            shifts, stretches = (values[region] for values in grid.axes)
            low, high = (np.array([side(shifts), side(stretches)]) for side in (np.min, np.max))
            wide = (high - low) / 2
            beyond = np.maximum(-low, high) >= half - node / 2
            if beyond.any():
                if (half[beyond] >= WIDEST).any():
                    return self._place(centre + grid.best, np.inf, grid)
                centre, half = centre + (low + high) / 2, np.where(beyond, np.minimum(2 * half, WIDEST), half)
                continue
            closer = wide + 2 * node  # with one, a region that a finer grid shows wider would reach its border again
            if between.max() > RESOLVED * allowed and (node > FINEST).any():
                if (closer < SHRINKS * half).any():
                    centre, half = centre + (low + high) / 2, np.minimum(closer, half)
                    continue
                if nodes < NODES[1] and ENOUGH < self._doubt(shifts, stretches) < HOPELESS:
                    nodes = 2 * nodes - 1
                    continue
            found = self._coloured(centre + grid.best, grid, noise2)
            if found > 1.1 * coloured and rounds < 3:
                centre, half = centre + (low + high) / 2, np.minimum(closer * np.sqrt(found / coloured), WIDEST)
                coloured, rounds = found, rounds + 1
                continue
            break
        doubt = self._doubt(shifts, stretches)
        if NARROW[0] < doubt <= NARROW[1]:
            region = (grid.squares <= grid.least + (SURELY * allowed) ** 2).any(0)
            shifts, stretches = (values[region] for values in grid.axes)
            doubt = min(doubt, max(self._doubt(shifts, stretches), doubt / 3))
            low, high = (np.array([side(shifts), side(stretches)]) for side in (np.min, np.max))
        return self._place(centre + (low + high) / 2, max(doubt, float(np.max(node)) / 2), grid)

    def _doubt(self, shifts: np.ndarray, stretches: np.ndarray) -> float:
        return max(float(np.ptp(shifts + stretches * x)) for x in self.needed) / 2

    def _place(self, centre: np.ndarray, doubt: float, grid: _Grid) -> Place:
        offset_V = self.mean_V[1] + grid.offset_V - grid.gain * self.mean_V[0]
        left = np.sqrt(grid.least / len(self.at)) / max(abs(grid.gain) * float(np.std(self.drive)), 1e-300)
        return Place(float(centre[0] + centre[1] * self.ends[0]), float(centre[0] + centre[1] * self.ends[1]),
                     doubt, grid.gain, offset_V, float(left))

    def _grid(self, centre: np.ndarray, half: np.ndarray, nodes: int) -> _Grid:
        """The squares that are left at each node, for each edge: of blocks at a table of shifts, added up."""
        size, shares = np.diff(self.starts, append=len(self.at)), np.linspace(-1, 1, 4 * nodes // 3)
        reach = half[0] + half[1] * np.abs(self.block_x)  # of each block
        at, reaches = self.at - centre[0] - centre[1] * self.x, np.repeat(reach, size)
        axes = np.meshgrid(*(np.linspace(-width, width, nodes) for width in half), indexing="ij")
        place = ((axes[0][..., None] + axes[1][..., None] * self.block_x) / reach + 1) * (len(shares) - 1) / 2
        lower = np.clip(place.astype(np.intp), 0, len(shares) - 2)
        upward, block = np.clip(place - lower, 0, 1), np.arange(len(size))
        found = []
        for edge in self.edges:
            table = np.empty((3, len(shares), len(size)))
            for j, share in enumerate(shares):
                drive = self._held(at - share * reaches, edge)
                for k, product in enumerate((drive, drive**2, drive * self.heard)):
                    table[k, j] = np.add.reduceat(product, self.starts)
            found.append([np.sum(sums[lower, block] * (1 - upward) + sums[lower + 1, block] * upward, axis=-1)
                          for sums in table])
        total, squares, product = (np.array(sums) for sums in zip(*found))
        varies = np.maximum(squares - total**2 / len(self.at), 1e-300)
        left = float(self.heard @ self.heard) - product**2 / varies
        best = np.unravel_index(int(np.argmin(left)), left.shape)
        gain = float(product[best] / varies[best])
        return _Grid(axes, left, float(max(left[best], 0.0)), int(best[0]),
                     np.array([axes[0][best[1:]], axes[1][best[1:]]]), gain, -gain * float(total[best]) / len(self.at))

    def _held(self, at: np.ndarray, edge: float) -> np.ndarray:
        """The drive at indices, held, and averaged over `edge` samples: 0 is a staircase, 1 straight lines."""
        last = len(self.drive) - 1
        if edge == 0:
            return self.drive[np.clip(np.floor(at + 0.5).astype(np.intp), 0, last)]

        def integral(end: np.ndarray) -> np.ndarray:
            index = np.clip(np.floor(end + 0.5).astype(np.intp), 0, last)
            return self.sums[index] + (end + 0.5 - index) * self.drive[index]
        return (integral(at + edge / 2) - integral(at - edge / 2)) / edge

    def _differs(self, edge: float, by: np.ndarray) -> float:
        """Root of the squares by which the drive differs from itself at a shift and stretch of parts of a sample."""
        share = np.minimum(by[0] + by[1] * np.abs(self.x), 1.0)
        return float(np.sqrt(self.steps @ (np.minimum(share**2 / edge, share) if edge else share)))

    def _coloured(self, centre: np.ndarray, grid: _Grid, noise2: float) -> float:
        """By how much noise that is not white, or not alike everywhere, spoils the place more than its size tells."""
        at = self.at - centre[0] - centre[1] * self.x
        left = self.heard - grid.gain * self._held(at, self.edges[grid.edge]) - grid.offset_V
        slope = grid.gain * (self._held(at + 0.5, 1.0) - self._held(at - 0.5, 1.0))
        says, knows = (np.add.reduceat(values, self.starts) for values in (left * slope, slope**2))
        places = np.stack([np.ones_like(self.block_x), self.block_x], axis=1)
        inverse = np.linalg.pinv((knows[:, None] * places).T @ places)
        actual = inverse @ (says[:, None] ** 2 * places).T @ places @ inverse
        ends = [np.array([1.0, x]) for x in self.needed]
        return max(1.0, *(float(end @ actual @ end / (end @ inverse @ end * noise2)) for end in ends))


class _Grid(NamedTuple):
    axes: list[np.ndarray]  # shift, stretch
    squares: np.ndarray  # by edge, shift and stretch
    least: float
    edge: int
    best: np.ndarray  # shift and stretch of the least
    gain: float
    offset_V: float
