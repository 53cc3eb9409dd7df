"""Named random streams: every number is a function of (seed, stream name, frame, pixel) alone.

A stream's 64-bit key comes from `numpy.random.SeedSequence` with the seed as entropy and the name and the frame number
in the spawn key. The key drives Philox4x32-10 (`render.engine.philox`) with the pixel's index in the whole detector in
the counter. A window therefore equals the crop of the full frame, and neither the number of threads, the order of
frames, nor an additional noise source changes the numbers of another source.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from numpy.typing import NDArray

from optics.errors import DomainError


@dataclass(frozen=True, slots=True)
class Streams:
    """A tree of random streams.

    Attributes
    ----------
    seed : int
        Root of everything; not negative.
    path : tuple of str
        Where in the tree this node is; see `child`.

    Raises
    ------
    DomainError
        On a seed that is not an integer >= 0.

    Examples
    --------
    >>> streams = Streams(7)
    >>> streams.key("read noise", 3) == Streams(7).key("read noise", 3)
    True
    """

    seed: int
    path: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if isinstance(self.seed, bool) or not isinstance(self.seed, Integral) or self.seed < 0:
            raise DomainError(f"seed = {self.seed!r}; an integer of at least 0 is needed")

    def child(self, *names: str | int) -> Streams:
        """Streams of a part of the experiment (a band, a target position), independent of any other part."""
        return Streams(self.seed, (*self.path, *(str(name) for name in names)))

    def sequence(self, name: str, frame: int = 0) -> np.random.SeedSequence:
        """Seed sequence of a stream in a frame."""
        if isinstance(frame, bool) or not isinstance(frame, Integral) or not 0 <= frame < 2**64:
            raise DomainError(f"frame = {frame!r}; an integer from 0 to 2^64 - 1 is needed")
        # NUL joins: no two lists of names without it give the same text. 128 bits of digest: no accidental twins.
        digest = hashlib.blake2b("\0".join((*self.path, name)).encode(), digest_size=16).digest()
        words = np.frombuffer(digest, dtype="<u4").tolist()
        return np.random.SeedSequence(int(self.seed), spawn_key=(*words, int(frame)))

    def key(self, name: str, frame: int = 0) -> int:
        """64-bit Philox key of a stream in a frame.

        Parameters
        ----------
        name : str
            Source of randomness, e.g. ``"photon"``.
        frame : int
            Frame number, 0 to 2^64 - 1.

        Returns
        -------
        int
            The same for the same (seed, path, name, frame), unrelated for any other.

        Raises
        ------
        DomainError
            On a frame number out of range.
        """
        low, high = self.sequence(name, frame).generate_state(2, np.uint32).tolist()
        return int(high) << 32 | int(low)

    def generator(self, name: str, frame: int = 0) -> np.random.Generator:
        """NumPy generator on the same stream, for draws that are few and not per pixel."""
        return np.random.Generator(np.random.Philox(self.sequence(name, frame)))


def stratified(rng: np.random.Generator, count: int, size: int) -> NDArray[np.float64]:
    """Latin hypercube (count, size) in 0 to 1 (McKay, Beckman & Conover 1979, Technometrics 21, 239).

    Every column has one number in each of ``count`` equal intervals, so that the scatter of inputs does not add to the
    scatter of results.
    """
    order = np.argsort(rng.random((size, count)), axis=1)
    return np.asarray(((order + rng.random((size, count))) / count).T)


def stratified_normal(rng: np.random.Generator, count: int, size: int) -> NDArray[np.float64]:
    """Stratified standard normal deviates (count, size); see `stratified`."""
    from scipy.special import ndtri

    return np.asarray(ndtri(stratified(rng, count, size)))
