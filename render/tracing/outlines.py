"""Quadrature inside the outlines of beams (`render.tracing.aimed_pupil`).

A point is launched at ``centre + rho B(azimuth) (cos, sin)``, with Gauss-Legendre nodes in rho^2 (Peirce 1957,
J. Soc. Indust. Appl. Math. 5, 66) and weight B^2 d(azimuth) / 2. Where the stop alone limits the beam, B is smooth: it
is found at a few azimuths and interpolated by its Fourier series, and equidistant azimuths
are the best there are. Those of every other ring lie in the gaps of its neighbours', which halves their number. The
axes' odd powers of rho, which a rule in rho^2 does not take exactly, come with the odd harmonics of B and are small.
Where something round stands in the middle of the beam its shadow has an outline of the same kind, and the nodes lie
between the squares of the two.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from render.tracing.aimed_pupil import AimedLens, Chiefs, Rims, find_shadow, find_stop_rims
from render.tracing.kernel import StarKernel
from render.tracing.pupil_points import OutlinePoints, bounding_outline

__all__ = [
    "ARMS",
    "GOLDEN",
    "NodePicks",
    "Outlines",
    "every_node",
    "find_outlines",
    "node_picks",
    "node_turns",
    "outline_series",
    "rings",
]


GOLDEN = 0.6180339887498949
PLASTIC = 1.324717957244746
ARMS = 10
"""Azimuths at which the stop's outline is found; its harmonics fall by a factor of five or more each."""
HARMONIC_LEFT = 1e-6
"""Largest amplitude of the highest harmonic, in radii of the launch disk, for which the others are believed."""
BETWEEN = 0.04
"""How much higher than on the sampled rays a beam may reach between them, in units of its range of heights."""
COARSE_ARMS = 36
"""Azimuths at which kinks are looked for."""
LEAST_IN_ARC = 3
WAVELENGTHS = 5
"""Most wavelengths per band at which outlines are found; polynomials in 1/wavelength^2 lead from these to others."""


@cache
def rings(count: int) -> tuple[FloatArray, FloatArray]:
    """Radii in the unit disk and weights (sum 1) of Gauss-Legendre nodes in r^2."""
    node, weight = np.polynomial.legendre.leggauss(count)
    return np.sqrt(0.5 * (1.0 + node)), 0.5 * weight


@dataclass(frozen=True, slots=True, eq=False)
class NodePicks:
    """The few nodes at which outlines are found, and how they lead to all."""

    kernel: StarKernel  # Holds the n stars at p times
    wavelength_nm: FloatArray  # (b, j) Wavelengths; nodes are all of the first time, then all of the second,
    colours: FloatArray  # (b, k, j) Factors that lead from these wavelengths to all
    times: FloatArray  # (n, t, p) Factors that lead from these times to all
    every: bool  # Whether they are all the nodes there are

    @property
    def count(self) -> int:
        """Number of picked nodes."""
        return self.times.shape[2] * self.wavelength_nm.shape[1]

    @property
    def nodes(self) -> int:
        """Number of all nodes."""
        return self.times.shape[1] * self.colours.shape[1]

    def ends(self) -> tuple[IntArray, FloatArray]:
        """Picked nodes of the first, middle and last wavelength at a middle time, and these wavelengths (b, 3)."""
        last = self.wavelength_nm.shape[1] - 1
        colours = np.array([0, (last + 1) // 2, last])
        start = self.times.shape[2] // 2 * (last + 1)
        return start + colours, np.ascontiguousarray(self.wavelength_nm[:, colours])

    def spread(self, values: FloatArray, stars: IntArray) -> FloatArray:
        """Values (s, b, count, m) of some stars at all nodes, (s, b, nodes, m)."""
        if self.every:
            return values
        shape = (*values.shape[:2], self.times.shape[2], self.wavelength_nm.shape[1], values.shape[3])
        coloured = np.einsum("bkj,sbpjm->sbpkm", self.colours, values.reshape(shape), optimize=True)
        everywhere = np.einsum("stp,sbpkm->sbtkm", self.times[stars], coloured, optimize=True)
        return np.asarray(everywhere.reshape(*values.shape[:2], self.nodes, values.shape[3]))


def node_picks(kernel: StarKernel, wavelength_nm: FloatArray, times: FloatArray | None = None) -> NodePicks:
    """Picks of wavelengths (b, k); polynomials in 1/wavelength^2 lead to the others."""
    # wavelength_nm (b, k), times (n, t, p)
    bands, nodes = wavelength_nm.shape
    spread = 0.5 * (nodes - 1) * (1.0 - np.cos(np.pi * np.arange(WAVELENGTHS) / (WAVELENGTHS - 1)))
    picks = np.arange(nodes) if nodes <= WAVELENGTHS else np.unique(np.rint(spread).astype(int))
    factors = np.ones((bands, nodes, len(picks)))
    t = wavelength_nm**-2.0
    for j, pick in enumerate(picks):
        for other in picks[picks != pick]:
            factors[..., j] *= (t - t[:, [other]]) / (t[:, [pick]] - t[:, [other]])
    every = times is None and len(picks) == nodes
    one = np.ones((kernel.count, 1, 1)) if times is None else times
    return NodePicks(kernel, np.ascontiguousarray(wavelength_nm[:, picks]), factors, one, every)


def every_node(kernel: StarKernel, wavelength_nm: FloatArray) -> NodePicks:
    """All wavelengths (b, k) of a camera at rest."""
    one = np.ones((kernel.count, 1, 1))
    return NodePicks(kernel, wavelength_nm, np.ones((*wavelength_nm.shape, 1)), one, every=True)


def node_turns(colours: int, times: int = 1) -> FloatArray:
    """By which part of their spacing azimuths are turned at every node (times x colours,).

    Golden-ratio steps from wavelength to wavelength fill each other's gaps; with times the two steps are those of the
    plastic number (M. Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).
    """
    if times == 1:
        return np.asarray(GOLDEN * np.arange(colours) % 1.0)
    return np.asarray((PLASTIC**-1 * np.arange(times)[:, None] + PLASTIC**-2 * np.arange(colours)).ravel() % 1.0)


@cache
def _series(arms: int) -> FloatArray:
    """Matrix (h, m) from m = ``arms`` equidistant samples to cosine and sine amplitudes, one after the other."""
    order, angle = np.arange(arms // 2 + 1), 2.0 * np.pi * np.arange(arms) / arms
    twice = np.where((order == 0) | (2 * order == arms), 1.0, 2.0)[:, None] / arms
    return np.concatenate([twice * np.cos(order[:, None] * angle), twice * np.sin(order[:, None] * angle)])


def outline_series(azimuth: FloatArray) -> FloatArray:
    """Matrices (k, a, `ARMS`) that lead from radii at `ARMS` azimuths to those at azimuths (k, a): Fourier series."""
    order = np.arange(ARMS // 2 + 1)[:, None]
    waves = np.concatenate([np.cos(order * azimuth[:, None]), np.sin(order * azimuth[:, None])], axis=1)
    return np.asarray(np.swapaxes(waves, 1, 2) @ _series(ARMS))


@dataclass(frozen=True, slots=True, eq=False)
class Outlines:
    """Outlines of the beams of n stars in b bands."""

    lens: AimedLens
    picks: NodePicks  # Where they are found
    chief: FloatArray  # (n, b, 2) Centres of the azimuths
    # (n, b, picked nodes, m) As the stop alone makes them, at m equidistant azimuths; NaN where no ray touches its
    # rim
    radius: FloatArray
    # clear, cut: (n,) Stars limited by the stop alone; stars for which other apertures count too. Others have no
    # outline
    clear: NDArray[np.bool_]
    cut: NDArray[np.bool_]
    shadow: FloatArray | None = None  # (n, b, picked nodes, m) Outlines of the shadow in the middle, where there is one

    def points(self, order: tuple[int, int], stars: IntArray) -> OutlinePoints:
        """Quadrature points of so many rings and azimuths inside smooth outlines."""
        count, arms = order
        turn = np.repeat(self.turns(2), arms, axis=1)
        azimuth = np.asarray(2.0 * np.pi / arms * (np.tile(np.arange(arms), 2) + turn), np.float64)
        matrix = outline_series(azimuth)
        radius = self._at(matrix, self.radius, stars)
        shadow = None if self.shadow is None else self._at(matrix, self.shadow, stars)
        ring, weight = rings(count)
        arm = np.arange(arms) + arms * (np.arange(count) % 2)[:, None]
        return OutlinePoints(
            centre=self.chief[stars],
            azimuth=azimuth,
            radius=radius,
            share=(radius**2 if shadow is None else radius**2 - shadow**2) / arms,
            arm=arm.ravel().astype(np.uint32),
            ring=np.repeat(ring, arms),
            ring_weight=np.repeat(weight, arms),
            shadow=shadow,
        )

    def turns(self, count: int) -> FloatArray:
        """First azimuths (k, rings) on so many rings, in parts of their distance."""
        turn = node_turns(self.picks.colours.shape[1], self.picks.times.shape[1])[:, None]
        return np.asarray((turn + 0.5 * (np.arange(count) % 2)) % 1.0)

    def entrance(self) -> FloatArray:
        """Light (n, b, k) that the stop alone would let through, in that of the launch disk; NaN where unknown."""
        area = (self.radius**2).mean(3, keepdims=True)
        return self.picks.spread(area, np.arange(len(area)))[..., 0]

    def bounding(self, stars: IntArray) -> OutlinePoints:
        """Points that bound the landing points at the wavelengths of `NodePicks.ends`: the rim, and fewer inside."""
        azimuth = 2.0 * np.pi * np.arange(ARMS)[None] / ARMS
        every, half = np.arange(ARMS), np.arange(0, ARMS, 2)
        ends = self.picks.ends()[0]
        shadow = None if self.shadow is None else self.shadow[stars][:, :, ends]
        radius = self.radius[stars][:, :, ends]
        return bounding_outline(self.chief[stars], azimuth, radius, (every, half, half + 1, half), shadow)

    def _at(self, matrix: FloatArray, radius: FloatArray, stars: IntArray) -> FloatArray:
        """Radii (s, b, k, a) of smooth outlines, by the matrix of their Fourier series."""
        return np.asarray((matrix @ self.picks.spread(radius[stars], stars)[..., None])[..., 0])


def find_outlines(lens: AimedLens, picks: NodePicks, chiefs: Chiefs) -> Outlines:
    """Outlines of all stars of a kernel; what kind each of them is."""
    aimed = np.asarray(np.isfinite(chiefs.points).all((1, 2)))
    centre = np.where(aimed[:, None, None], chiefs.points, 0.0)
    azimuth = np.tile(2.0 * np.pi * np.arange(ARMS) / ARMS, (picks.count, 1))
    rims = find_stop_rims(lens, picks.kernel, centre, picks.wavelength_nm, azimuth)
    clear, shadow = aimed & _only_the_stop(rims), None
    if lens.holes:
        shadow, found = find_shadow(lens, picks.kernel, centre, picks.wavelength_nm, azimuth)
        clear = clear & found.all((1, 2, 3)) & _smooth(shadow) & (shadow < rims.radius).all((1, 2, 3))
    return Outlines(
        lens=lens, picks=picks, chief=centre, radius=rims.radius, clear=clear, cut=aimed & ~clear, shadow=shadow
    )


def _only_the_stop(rims: Rims) -> NDArray[np.bool_]:
    """Stars (n,) whose beam is smooth and touches no aperture but the stop."""
    others = rims.height[0]
    most, least = others.max(3), others.min(3)
    free = most + BETWEEN * (most - least) < 1.0
    return np.asarray(rims.good.all((1, 2, 3)) & free.all((1, 2)) & _smooth(rims.radius))


def _smooth(radius: FloatArray) -> NDArray[np.bool_]:
    """Stars (n,) whose outlines (n, b, k, `ARMS`) are believed."""
    highest = np.abs(radius @ (-1.0) ** np.arange(ARMS)) / ARMS
    return np.asarray((highest < HARMONIC_LEFT).all((1, 2)))
