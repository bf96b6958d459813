"""K transforms for a database: deterministic annealing over the clips of many sequences (section V, Algorithm 1).

    files ─read one by one─► truncated spectra M_i D̃ ─by marker set─► anneal ─► K transforms for each set

Only the spectra of the clips are kept, some 15 times smaller than the motion; beyond a limit of memory they go to a
temporary file and are streamed. A file coded with these transforms holds the number of one for each clip; the
transforms are shared bytes, equal in all files, and every file decodes alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from os import PathLike
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ...motion import Floats, Motion
from ...stages import dct, gaps
from . import parameters, stream, transform
from .codec import Hou2014

Names = tuple[str, ...]
Progress = Callable[[str, int, int], None]

WARMTH = 0.3
"""The first temperature, in mean differences of a clip's errors between bases."""

BLOCK_CLIPS = 256
"""Clips that are in memory together when spectra are streamed."""


@dataclass(frozen=True)
class Annealing:
    """How an annealing went.

    choice (clips,): the transform that W ends at for each. distortions: (7) before each iteration, m², what lies
    outside the kept frequencies left out.
    """

    iterations: int
    converged: bool
    choice: NDArray[np.int64]
    distortions: tuple[float, ...]


@dataclass(frozen=True)
class Hou2014Database:
    """Settings of the learning. `fit` makes a `Learned`."""

    transforms: int = 4  # K
    components: int = parameters.COMPONENTS  # k, of the subspaces that clips are sorted into
    stored: int | None = None  # components of each transform that are stored; all where not given
    clip_frames: int = parameters.CLIP_FRAMES  # L
    frequencies: int | None = None  # l; by (12) with the paper's k of 30
    tolerance: float = 1e-6
    most_iterations: int = 60
    step_m: float = 0.005  # the finest step of coefficients that the transforms are stored for
    memory_bytes: int = 1 << 29  # spectra beyond this go to a temporary file
    seed: int = 0

    def fit(self, sources: Iterable[Motion | str | PathLike[str]], progress: Progress | None = None) -> Learned:
        """K transforms for each marker set among these motions or files, read one at a time.

        progress(what, done, of) is called as it goes. Raises BadInput where no source holds a motion.
        """
        groups: dict[Names, _Spectra] = {}
        sources = list(sources)
        for number, source in enumerate(sources):
            motion = source if isinstance(source, Motion) else _read(source)
            if len(motion) and motion.points and not motion.gaps.all():
                limit = self.memory_bytes // max(1, len(groups) + 1)
                group = groups.setdefault(motion.names, _Spectra(3 * motion.points, limit))
                self._add(group, motion)
            if progress:
                progress("reading", number + 1, len(sources))
        if not groups:
            raise BadInput("no motion to learn transforms from")
        learned: dict[Names, tuple[bytes, ...]] = {}
        how: dict[Names, Annealing] = {}
        for names, spectra in groups.items():
            found, how[names] = self._anneal(spectra, progress)
            kept = [one.leading(self.stored or len(one)) for one in found]
            learned[names] = tuple(one.rounded(self.step_m).pack(None) for one in kept)
            spectra.close()
        return Learned(learned, how)

    def _add(self, group: _Spectra, motion: Motion) -> None:
        """The spectra of a motion's clips about its mean pose; clips are as in equal segmentation."""
        filled, _ = gaps.fill(motion.positions)
        rows = filled.reshape(len(motion), -1)
        rows = rows - rows.mean(axis=0)
        start = 0
        for length, run in stream.runs(stream.equal_lengths(len(motion), self.clip_frames)):
            stop = start + length * (run.stop - run.start)
            kept = self.frequencies or parameters.frequencies(parameters.COMPONENTS, length)
            group.add(dct.forward(rows[start:stop].reshape(-1, length, rows.shape[1]), min(kept, length), axis=1))
            start = stop

    def _anneal(self, spectra: _Spectra, progress: Progress | None) -> tuple[list[transform.Transform], Annealing]:
        """Algorithm 1: W by (9) and B_j by (10) and Theorem 1 in turn, while the temperature is halved."""
        dimensions, k = spectra.dimensions, min(self.components, spectra.dimensions)
        rng = np.random.default_rng(self.seed)
        count = min(self.transforms, spectra.clips)
        bases = [np.linalg.qr(rng.standard_normal((dimensions, k)))[0] for _ in range(count)]
        found: list[transform.Transform] = []
        weights = np.full((spectra.clips, count), 1 / count)
        temperature = 1e-300
        distortions: list[float] = []
        converged = False
        for iteration in range(self.most_iterations):
            errors = spectra.errors(bases)
            if iteration == 1:
                temperature = max(WARMTH * float(np.ptp(errors, axis=1).mean()), 1e-300)
            before, weights = weights, _softmax(-errors / temperature)
            distortions.append(float((weights * errors).sum()))
            found = [transform.fit(c) for c in spectra.covariances(weights)]
            moved = max(_distance(one.matrix[:, :k], basis) for one, basis in zip(found, bases, strict=True))
            bases = [one.matrix[:, :k] for one in found]
            temperature /= 2
            if progress:
                progress("annealing", iteration + 1, self.most_iterations)
            if max(moved, float(np.abs(weights - before).max())) < self.tolerance:
                converged = True
                break
        choice = weights.argmax(axis=1)
        used = [j for j in range(count) if (choice == j).any()]
        report = Annealing(len(distortions), converged, np.searchsorted(used, choice), tuple(distortions))
        return [found[j] for j in used], report


@dataclass(frozen=True)
class Learned:
    """Transforms by marker set, as bytes. how: the annealing of each."""

    transforms: Mapping[Names, tuple[bytes, ...]]
    how: Mapping[Names, Annealing] = field(default_factory=dict)

    def codec(self, motion: Motion, **settings: Any) -> Hou2014:
        """A codec with the transforms of this motion's marker set; one that finds its own where there are none."""
        return Hou2014(transforms=self.transforms.get(motion.names, ()), **settings)


class _Spectra:
    """Truncated spectra of clips, (l_i, 3n) each in float32: in memory, or beyond `limit` bytes in a temporary file."""

    def __init__(self, dimensions: int, limit: int) -> None:
        self.dimensions, self.limit = dimensions, limit
        self.kept: list[int] = []
        self.energy: list[float] = []
        self._parts: list[NDArray[np.float32]] = []
        self._file: IO[bytes] | None = None

    @property
    def clips(self) -> int:
        return len(self.kept)

    def add(self, spectra: Floats) -> None:
        """Clips of one length: (clips, l, 3n)."""
        self.kept.extend([spectra.shape[1]] * len(spectra))
        part = spectra.reshape(-1, self.dimensions).astype(np.float32)
        if self._file is None and sum(self.kept) * self.dimensions * 4 > self.limit:
            self._file = TemporaryFile()  # noqa: SIM115  closed by `close`
            for earlier in self._parts:
                self._file.write(earlier.tobytes())
            self._parts.clear()
        if self._file is None:
            self._parts.append(part)
        else:
            self._file.write(part.tobytes())

    def blocks(self) -> Iterator[tuple[slice, NDArray[np.int64], Floats]]:
        """(clips, the row that each begins at, rows) of a few clips at a time."""
        if self._file is None and len(self._parts) > 1:
            self._parts = [np.concatenate(self._parts)]
        ends = np.concatenate([[0], np.cumsum(self.kept)])
        for a in range(0, self.clips, BLOCK_CLIPS):
            b = min(a + BLOCK_CLIPS, self.clips)
            if self._file is None:
                rows = self._parts[0][ends[a] : ends[b]]
            else:
                self._file.seek(4 * self.dimensions * int(ends[a]))
                data = self._file.read(4 * self.dimensions * int(ends[b] - ends[a]))
                rows = np.frombuffer(data, np.float32).reshape(-1, self.dimensions)
            yield slice(a, b), ends[a:b] - ends[a], rows.astype(np.float64)

    def errors(self, bases: list[Floats]) -> Floats:
        """‖M_i D̃ − B_j S_ij‖²_F with S_ij by (8), (clips, K): what the truncated spectrum loses in each subspace."""
        result = np.empty((self.clips, len(bases)))
        for clips, starts, rows in self.blocks():
            whole = np.add.reduceat(np.einsum("rd,rd->r", rows, rows), starts)
            for j, basis in enumerate(bases):
                coefficients = rows @ basis
                result[clips, j] = whole - np.add.reduceat(np.einsum("rk,rk->r", coefficients, coefficients), starts)
        return np.maximum(result, 0.0)

    def covariances(self, weights: Floats) -> list[Floats]:
        """C_j, equation (10)."""
        totals = [np.zeros((self.dimensions,) * 2) for _ in range(weights.shape[1])]
        for clips, _, rows in self.blocks():
            kept = self.kept[clips]
            for j, total in enumerate(totals):
                part = rows * np.sqrt(np.repeat(weights[clips, j], kept))[:, None]
                total += part.T @ part
        return totals

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


def _softmax(logits: Floats) -> Floats:
    """Equation (9)."""
    powers = np.exp(logits - logits.max(axis=1, keepdims=True))
    return powers / powers.sum(axis=1, keepdims=True)


def _distance(a: Floats, b: Floats) -> float:
    """How far apart two subspaces are: the Frobenius norm of what a leaves of b. Columns may turn within them."""
    return float(np.linalg.norm(b - a @ (a.T @ b)))


def _read(path: str | PathLike[str]) -> Motion:
    from ... import formats

    motion = formats.read(path)
    if not isinstance(motion, Motion):
        raise BadInput(f"{path} holds point clouds, not motion")
    return motion
