"""K left transforms for a database: deterministic annealing over the clips of many sequences (section V, Algorithm 1).

    files ─read one by one─► truncated spectra M_i D̃ ─by marker set─► annealing ─► K left transforms per marker set

Only the spectra of the clips are kept, about 15 times smaller than the motion. Beyond a memory limit they go to a
temporary file. A file coded with these transforms stores the index of one for each clip, and the transforms themselves
as shared bytes, so it decodes alone.
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
from ...motion import Motion
from ...stages import dct, gaps
from ...typing import Floats, Integers
from . import left_transform, parameters, stream
from .codec import Hou2014
from .left_transform import LeftTransform

Names = tuple[str, ...]
Progress = Callable[[str, int, int], None]

INITIAL_TEMPERATURE = 0.3
"""As a multiple of the mean difference between a clip's largest and smallest error over the bases."""

LOWEST_TEMPERATURE = 1e-300
"""Stands for zero, where (9) assigns each clip to its best basis."""

BLOCK_CLIPS = 256
"""Clips in memory at a time when spectra come from a temporary file."""


@dataclass(frozen=True)
class Annealing:
    """Result of one annealing.

    transform_index (clips,): the left transform with the largest final weight W for each clip. distortions: the
    objective (7) before each iteration in m², without the frequencies that the truncated DCT discards.
    """

    iterations: int
    converged: bool
    transform_index: Integers
    distortions: tuple[float, ...]


@dataclass(frozen=True)
class Hou2014Database:
    """Settings of the learning; `fit` returns `LearnedTransforms`."""

    transforms: int = 4  # K
    components: int = parameters.COMPONENTS  # k of the subspaces that Algorithm 1 fits
    stored: int | None = None  # components stored of each transform; None: all
    clip_frames: int = parameters.CLIP_FRAMES  # L
    frequencies: int | None = None  # l; None: equation (12) with the paper's k of 30
    tolerance: float = 1e-6  # convergence: largest change of B_j and W
    most_iterations: int = 60
    step_m: float = 0.005  # smallest quantisation step that the stored precision is made for
    memory_bytes: int = 1 << 29  # spectra beyond this go to a temporary file
    seed: int = 0

    def fit(
        self, sources: Iterable[Motion | str | PathLike[str]], progress: Progress | None = None
    ) -> LearnedTransforms:
        """K left transforms for each marker set among these motions or files, which are read one at a time.

        progress(stage, done, total) is called after every file and iteration. Raises BadInput if no source has samples.
        """
        spectra_by_names = self._read_spectra(list(sources), progress)
        if not spectra_by_names:
            raise BadInput("Hou2014Database.fit needs at least one motion with samples")
        packed: dict[Names, tuple[bytes, ...]] = {}
        annealings: dict[Names, Annealing] = {}
        for names, spectra in spectra_by_names.items():
            fitted, annealings[names] = self._anneal(spectra, progress)
            truncated = [transform.leading(self.stored or len(transform)) for transform in fitted]
            packed[names] = tuple(transform.rounded(self.step_m).pack(None) for transform in truncated)
            spectra.close()
        return LearnedTransforms(packed, annealings)

    def _read_spectra(
        self, sources: list[Motion | str | PathLike[str]], progress: Progress | None
    ) -> dict[Names, _ClipSpectra]:
        """The spectra of all clips by marker set."""
        spectra_by_names: dict[Names, _ClipSpectra] = {}
        for number, source in enumerate(sources):
            motion = source if isinstance(source, Motion) else _read(source)
            if len(motion) and motion.points and not motion.gaps.all():
                limit = self.memory_bytes // max(1, len(spectra_by_names) + 1)
                spectra = spectra_by_names.setdefault(motion.names, _ClipSpectra(3 * motion.points, limit))
                self._add_clips(spectra, motion)
            if progress:
                progress("reading", number + 1, len(sources))
        return spectra_by_names

    def _add_clips(self, spectra: _ClipSpectra, motion: Motion) -> None:
        """Add the truncated spectra M_i D̃ of equal clips, after subtracting the motion's mean pose."""
        filled, _ = gaps.fill(motion.positions)
        rows = filled.reshape(len(motion), -1)
        rows = rows - rows.mean(axis=0)
        start = 0
        for length, run in stream.equal_length_runs(stream.equal_lengths(len(motion), self.clip_frames)):
            stop = start + length * (run.stop - run.start)
            count = self.frequencies or parameters.frequencies(parameters.COMPONENTS, length)
            spectra.add(dct.forward(rows[start:stop].reshape(-1, length, rows.shape[1]), min(count, length), axis=1))
            start = stop

    def _anneal(self, spectra: _ClipSpectra, progress: Progress | None) -> tuple[list[LeftTransform], Annealing]:
        """Algorithm 1: update W by (9), B_j by (10) and Theorem 1, halve the temperature, until convergence."""
        dimensions, k = spectra.dimensions, min(self.components, spectra.dimensions)
        rng = np.random.default_rng(self.seed)
        count = min(self.transforms, spectra.clips)
        bases = [np.linalg.qr(rng.standard_normal((dimensions, k)))[0] for _ in range(count)]
        fitted: list[LeftTransform] = []
        weights = np.full((spectra.clips, count), 1 / count)
        temperature = LOWEST_TEMPERATURE
        distortions: list[float] = []
        converged = False
        for iteration in range(self.most_iterations):
            errors = spectra.errors(bases)
            if iteration == 1:  # the errors of random bases say nothing about the temperature
                temperature = max(INITIAL_TEMPERATURE * float(np.ptp(errors, axis=1).mean()), LOWEST_TEMPERATURE)
            previous_weights, weights = weights, _softmax(-errors / temperature)
            distortions.append(float((weights * errors).sum()))
            fitted = [left_transform.fit(c) for c in spectra.covariances(weights)]
            basis_change = max(
                _subspace_distance(new.matrix[:, :k], basis) for new, basis in zip(fitted, bases, strict=True)
            )
            bases = [new.matrix[:, :k] for new in fitted]
            temperature /= 2
            if progress:
                progress("annealing", iteration + 1, self.most_iterations)
            if max(basis_change, float(np.abs(weights - previous_weights).max())) < self.tolerance:
                converged = True
                break
        transform_index = weights.argmax(axis=1)
        used = [j for j in range(count) if (transform_index == j).any()]
        annealing = Annealing(
            iterations=len(distortions),
            converged=converged,
            transform_index=np.searchsorted(used, transform_index),
            distortions=tuple(distortions),
        )
        return [fitted[j] for j in used], annealing


@dataclass(frozen=True)
class LearnedTransforms:
    """Left transforms as bytes, and the result of the annealing, by marker set."""

    transforms: Mapping[Names, tuple[bytes, ...]]
    annealings: Mapping[Names, Annealing] = field(default_factory=dict)

    def codec(self, motion: Motion, **settings: Any) -> Hou2014:
        """A codec with the transforms of this motion's marker set; without any, it fits B to the motion."""
        return Hou2014(transforms=self.transforms.get(motion.names, ()), **settings)


class _ClipSpectra:
    """Truncated spectra of clips, (l_i, 3n) float32 each: in memory, or beyond `limit` bytes in a temporary file."""

    def __init__(self, dimensions: int, limit: int) -> None:
        self.dimensions, self.limit = dimensions, limit
        self.frequencies: list[int] = []  # l_i
        self._parts: list[NDArray[np.float32]] = []
        self._file: IO[bytes] | None = None

    @property
    def clips(self) -> int:
        """Number of clips."""
        return len(self.frequencies)

    def add(self, spectra: Floats) -> None:
        """Add clips of equal length, (clips, l, 3n)."""
        self.frequencies.extend([spectra.shape[1]] * len(spectra))
        part = spectra.reshape(-1, self.dimensions).astype(np.float32)
        if self._file is None and sum(self.frequencies) * self.dimensions * 4 > self.limit:
            self._file = TemporaryFile()  # noqa: SIM115  closed by `close`
            for earlier in self._parts:
                self._file.write(earlier.tobytes())
            self._parts.clear()
        if self._file is None:
            self._parts.append(part)
        else:
            self._file.write(part.tobytes())

    def blocks(self) -> Iterator[tuple[slice, Integers, Floats]]:
        """The spectra in blocks of BLOCK_CLIPS: (clips, first row of each clip in the block, rows)."""
        if self._file is None and len(self._parts) > 1:
            self._parts = [np.concatenate(self._parts)]
        ends = np.concatenate([[0], np.cumsum(self.frequencies)])
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
        """‖M_i D̃ − B_j S_ij‖²_F with S_ij by (8), (clips, K): the energy of each clip outside each subspace."""
        result = np.empty((self.clips, len(bases)))
        for clips, starts, rows in self.blocks():
            energies = np.add.reduceat(np.einsum("rd,rd->r", rows, rows), starts)
            for j, basis in enumerate(bases):
                coefficients = rows @ basis
                inside = np.add.reduceat(np.einsum("rk,rk->r", coefficients, coefficients), starts)
                result[clips, j] = energies - inside
        return np.maximum(result, 0.0)

    def covariances(self, weights: Floats) -> list[Floats]:
        """C_j, equation (10), (3n, 3n) each. weights: W, (clips, K)."""
        totals = [np.zeros((self.dimensions,) * 2) for _ in range(weights.shape[1])]
        for clips, _, rows in self.blocks():
            frequencies = self.frequencies[clips]
            for j, total in enumerate(totals):
                weighted = rows * np.sqrt(np.repeat(weights[clips, j], frequencies))[:, None]
                total += weighted.T @ weighted
        return totals

    def close(self) -> None:
        """Delete the temporary file."""
        if self._file is not None:
            self._file.close()


def _softmax(logits: Floats) -> Floats:
    """Softmax over the last axis: equation (9)."""
    powers = np.exp(logits - logits.max(axis=1, keepdims=True))
    return powers / powers.sum(axis=1, keepdims=True)


def _subspace_distance(a: Floats, b: Floats) -> float:
    """Distance between the column spaces of two orthonormal bases: ‖b − a aᵀ b‖_F, zero for any rotation of a."""
    return float(np.linalg.norm(b - a @ (a.T @ b)))


def _read(path: str | PathLike[str]) -> Motion:
    from ... import formats

    motion = formats.read(path)
    if not isinstance(motion, Motion):
        raise BadInput(f"{path} holds point clouds; Hou2014Database.fit needs motion")
    return motion
