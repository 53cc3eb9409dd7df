"""Quadrature inside the outlines of beams (`render.tracing.pupil.ray_aiming`).

A point is launched at ``centre + rho B(azimuth) (cos, sin)``, with Gauss-Legendre nodes in rho^2 (Peirce 1957, J. Soc.
Indust. Appl. Math. 5, 66) and weight B^2 d(azimuth) / 2. Where the stop alone limits the beam, B is smooth: it is found
at a few azimuths and interpolated by its Fourier series, and equidistant azimuths are optimal. The azimuths of every
other ring lie in the gaps of its neighbours', which halves their number. The axes' odd powers of rho, which a rule in
rho^2 does not take exactly, come with the odd harmonics of B and are small. Where something round stands in the middle
of the beam its shadow has an outline of the same kind, and the nodes lie between the squares of the two.

Where several apertures cut the beam the outline is the least of several smooth functions of the azimuth, one per
aperture (`Arcs`). It is sampled coarsely; where the aperture that limits the beam changes, there is a kink, and each
arc between two of them gets its Gauss rule, at whose azimuths the outline is solved exactly. A kink that is displaced
by d costs its change of slope times d^2 / 2, so that two steps of false position for the difference of the heights on
the two apertures are enough (d is some 1e-4). An arc between two samples is missed; the light beyond it is at most 2e-5
of the light.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import roots_legendre

from optics.arrays import FloatArray, IntArray
from render.tracing.pupil.points import OutlinePoints, bounding_outline
from render.tracing.pupil.ray_aiming import AimedLens, Chiefs, OutlineSearch, Rims
from render.tracing.rays.kernel import StarKernel

GOLDEN = 0.6180339887498949
PLASTIC = 1.324717957244746
ARMS = 10
"""Azimuths at which the stop's outline is found; its harmonics fall by a factor of five or more each."""
HARMONIC_LEFT = 1e-6
"""Largest amplitude of the highest harmonic, in radii of the launch disk, of a smooth outline."""
BETWEEN = 0.04
"""How much higher than on the sampled rays a beam may reach between them, in units of its range of heights."""
WAVELENGTHS = 5
"""Most wavelengths per band at which outlines are found; polynomials in 1/wavelength^2 lead from these to others."""


@cache
def rings(count: int) -> tuple[FloatArray, FloatArray]:
    """Radii in the unit disk and weights (sum 1) of Gauss-Legendre nodes in r^2."""
    node, weight = np.polynomial.legendre.leggauss(count)
    return np.sqrt(0.5 * (1.0 + node)), 0.5 * weight


@dataclass(frozen=True, slots=True, eq=False)
class NodePicks:
    """Selected nodes at which outlines are solved, and the interpolation to all nodes."""

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
    ones = np.ones((kernel.count, 1, 1)) if times is None else times
    return NodePicks(kernel, np.ascontiguousarray(wavelength_nm[:, picks]), factors, ones, every)


def every_node(kernel: StarKernel, wavelength_nm: FloatArray) -> NodePicks:
    """All wavelengths (b, k) of a camera at rest."""
    ones = np.ones((kernel.count, 1, 1))
    return NodePicks(kernel, wavelength_nm, np.ones((*wavelength_nm.shape, 1)), ones, every=True)


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
    picks: NodePicks  # Nodes at which they are solved
    chief: FloatArray  # (n, b, 2) Centres of the azimuths
    radius: FloatArray  # (n, b, picked nodes, m) By the stop alone, at m equidistant azimuths; NaN without
    clear: NDArray[np.bool_]  # (n,) Stars limited by the stop alone
    cut: NDArray[np.bool_]  # (n,) Stars limited by other apertures too; others have no outline
    shadow: FloatArray | None = None  # (n, b, picked nodes, m) Outlines of the shadow in the middle, where there is one

    def points(self, order: tuple[int, int], stars: IntArray) -> OutlinePoints:
        """Quadrature points of a number of rings and azimuths inside smooth outlines."""
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
            area=(radius**2 if shadow is None else radius**2 - shadow**2) / arms,
            arm=arm.ravel().astype(np.uint32),
            ring=np.repeat(ring, arms),
            ring_weight=np.repeat(weight, arms),
            shadow=shadow,
        )

    def turns(self, count: int) -> FloatArray:
        """First azimuths (k, rings) on the rings, in parts of their distance."""
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
    beams = OutlineSearch(lens, picks.kernel, centre, picks.wavelength_nm, azimuth)
    rims = beams.stop_rims()
    clear, shadow = aimed & _only_the_stop(rims), None
    if lens.holes:
        shadow, has_shadow = beams.shadow()
        clear = clear & has_shadow.all((1, 2, 3)) & _smooth(shadow) & (shadow < rims.radius).all((1, 2, 3))
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
    """Stars (n,) whose outlines (n, b, k, `ARMS`) are smooth."""
    highest = np.abs(radius @ (-1.0) ** np.arange(ARMS)) / ARMS
    return np.asarray((highest < HARMONIC_LEFT).all((1, 2)))


COARSE = 36
"""Azimuths at which the outline is sampled."""
MOST_ARCS = 10
LEAST_IN_ARC = 2
NARROWINGS = 1
"""Steps of false position after the first."""
ARC_LADDER = tuple(
    zip((6, 7, 8, 9, 10, 11, 13, 16, 20, 25, 32, 41), (22, 26, 31, 36, 42, 48, 58, 72, 90, 112, 144, 184), strict=True)
)
"""Rings and azimuths that are tried, in this order; the fewest azimuths are `LEAST_IN_ARC` times `MOST_ARCS`."""


@dataclass(frozen=True, slots=True, eq=False)
class Arcs:
    """Outlines with kinks of some of a kernel's stars."""

    lens: AimedLens
    picks: NodePicks  # Nodes at which they are solved
    stars: IntArray  # (s,) Which of the kernel's stars, ascending
    centre: FloatArray  # (s, b, 2) Of the azimuths, in radii of the launch disk
    radius: FloatArray  # (s, b, picked nodes, `COARSE`) Coarse outline
    start: FloatArray  # (s, b, picked nodes, `MOST_ARCS`) Start of the arcs [rad]
    length: FloatArray  # Their length; 0 for none, one of 2 pi without a kink

    def points(self, order: tuple[int, int], stars: IntArray) -> OutlinePoints:
        """Quadrature points of a number of rings and azimuths for some of the stars."""
        at = np.searchsorted(self.stars, stars)
        picks = self.picks
        azimuth, weight = _rule(self.start[at], self.length[at], order[1], alike=not picks.every)
        beams = OutlineSearch(self.lens, picks.kernel, self.centre[at], picks.wavelength_nm, azimuth, stars)
        rims = beams.rims()
        rim = np.where(rims.good, rims.radius, np.nan)  # its rays are lost, and the star is sampled otherwise
        shadow = None
        if self.lens.holes:
            dark, clear = beams.shadow()
            rim = np.where(clear & (dark < rim), rim, np.nan)
            shadow = picks.spread(dark, stars)
        azimuth, radius, weight = (picks.spread(v, stars) for v in (azimuth, rim, weight))
        ring, ring_weight = rings(order[0])
        lit = radius**2 if shadow is None else radius**2 - shadow**2
        return OutlinePoints(
            centre=self.centre[at],
            azimuth=azimuth,
            radius=radius,
            area=np.nan_to_num(lit) * weight,
            arm=np.tile(np.arange(order[1], dtype=np.uint32), order[0]),
            ring=np.repeat(ring, order[1]),
            ring_weight=np.repeat(ring_weight, order[1]),
            shadow=shadow,
        )

    def bounding(self, stars: IntArray) -> OutlinePoints:
        """Points that bound the landing points at the wavelengths of `NodePicks.ends`: the rim, and fewer inside."""
        at = np.searchsorted(self.stars, stars)
        arms = np.arange(0, COARSE, 2), *(np.arange(first, COARSE, 6) for first in range(3))
        radius = self.radius[at][:, :, self.picks.ends()[0]]
        return bounding_outline(self.centre[at], _coarse_azimuth(), radius, arms)


def _coarse_azimuth() -> FloatArray:
    """Azimuths (1, `COARSE`) [rad]."""
    return 2.0 * np.pi * np.arange(COARSE)[None] / COARSE


@cache
def _gauss_rule(count: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights of Gauss and Legendre on (0, 1)."""
    x, w = roots_legendre(count)
    return 0.5 * (1.0 + x), 0.5 * w


def _gauss_tables(sizes: IntArray) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights of rules by number of points, each in the row of its number; the other rows are empty."""
    most = int(sizes.max())
    nodes, weights = np.zeros((2, most + 1, most))
    for n in np.unique(sizes[sizes > 0]).tolist():
        nodes[n, :n], weights[n, :n] = _gauss_rule(n)
    return nodes, weights


def _rule(start: FloatArray, length: FloatArray, arms: int, alike: bool) -> tuple[FloatArray, FloatArray]:
    """Azimuths and weights (s, b, k, arms), sum 1: on every arc a number in proportion to its length, two at least.

    ``alike``: equal numbers for all nodes of a star, by the greatest length of each arc, so that nodes can be
    interpolated.
    """
    real = length > 0.0
    most = np.broadcast_to(length.max(2, keepdims=True), length.shape) if alike else length
    quota = (arms - LEAST_IN_ARC * real.sum(-1, keepdims=True)) * most / most.sum(-1, keepdims=True)
    count = np.where(real, LEAST_IN_ARC + np.floor(quota), 0).astype(int)
    rank = np.argsort(np.argsort(-np.where(real, quota - np.floor(quota), -1.0), axis=-1, kind="stable"), axis=-1)
    count += rank < (arms - count.sum(-1, keepdims=True))
    end = np.cumsum(count, axis=-1)
    number = np.arange(arms)
    arc = (number[:, None] >= end[..., None, :]).sum(-1)
    inside = number - np.take_along_axis(end - count, arc, -1)
    nodes, weights = _gauss_tables(count)
    size, first, span = (np.take_along_axis(v, arc, -1) for v in (count, start, length))
    azimuth = first + span * nodes[size, inside]
    weight = span / (2.0 * np.pi) * weights[size, inside]
    smooth = real.sum(-1) == 1  # no kink: equidistant azimuths
    turn = 0.0 if alike else GOLDEN * np.arange(start.shape[2])[:, None] % 1.0
    even = np.broadcast_to(2.0 * np.pi / arms * (number + turn), azimuth.shape)
    return np.where(smooth[..., None], even, azimuth), np.where(smooth[..., None], 1.0 / arms, weight)


@dataclass(frozen=True, slots=True)
class _Kinks:
    """Kinks (..., `MOST_ARCS`) in ascending order, the unused ones last.

    ``before`` and ``after`` limit the beam on their sides; ``low`` and ``high`` enclose them, and there the height on
    the aperture after minus that on the one before is ``at_low`` < 0 and ``at_high`` > 0.
    """

    used: NDArray[np.bool_]
    before: IntArray
    after: IntArray
    low: FloatArray
    high: FloatArray
    at_low: FloatArray
    at_high: FloatArray

    def azimuth(self) -> FloatArray:
        """Azimuths of the kinks by linear interpolation."""
        part = self.at_low / (self.at_low - self.at_high)
        return np.asarray(self.low + part * (self.high - self.low))

    def alike(self) -> NDArray[np.bool_]:
        """Nodes (s, b, k) whose kinks are between the same apertures as at the first node."""
        same = [self.used == self.used[:, :, :1]]
        same += [~self.used | (v == v[:, :, :1]) for v in (self.before, self.after)]
        return np.asarray(np.logical_and.reduce(same).all(-1))

    def narrowed(self, azimuth: FloatArray, height: FloatArray) -> _Kinks:
        """With the heights (a, ...) of rays at an azimuth of every kink."""
        difference = _height_of(height, self.after) - _height_of(height, self.before)
        before_kink, after_kink = self.used & (difference < 0.0), self.used & (difference > 0.0)
        return replace(
            self,
            low=np.where(before_kink, azimuth, self.low),
            at_low=np.where(before_kink, difference, self.at_low),
            high=np.where(after_kink, azimuth, self.high),
            at_high=np.where(after_kink, difference, self.at_high),
        )


def _height_of(height: FloatArray, which: IntArray) -> FloatArray:
    """Heights on one aperture per ray."""
    return np.asarray(np.take_along_axis(height, which[None], 0)[0])


def _coarse_kinks(height: FloatArray) -> tuple[_Kinks, NDArray[np.bool_]]:
    """Kinks of outlines whose rays have these heights (a, ..., `COARSE`), and which outlines have few enough."""
    active, ahead = height.argmax(0), np.roll(height, -1, axis=-1)
    following = np.roll(active, -1, axis=-1)
    change = active != following
    pick = np.argsort(~change, axis=-1, kind="stable")[..., :MOST_ARCS]
    used = np.take_along_axis(change, pick, -1)
    before, after = np.take_along_axis(active, pick, -1), np.take_along_axis(following, pick, -1)
    both = np.broadcast_to(pick, (len(height), *pick.shape))
    low, high = (np.asarray(np.take_along_axis(v, both, -1), np.float64) for v in (height, ahead))
    return _Kinks(
        used=used,
        before=before,
        after=after,
        low=pick.astype(np.float64) * (2.0 * np.pi / COARSE),
        high=(pick + 1).astype(np.float64) * (2.0 * np.pi / COARSE),
        at_low=np.where(used, _height_of(low, after) - _height_of(low, before), -1.0),
        at_high=np.where(used, _height_of(high, after) - _height_of(high, before), 1.0),
    ), np.asarray(change.sum(-1) <= MOST_ARCS)


def _between(kinks: _Kinks) -> tuple[FloatArray, FloatArray]:
    """Start and length (..., `MOST_ARCS`) of the arcs between kinks; a full turn without kinks."""
    number = kinks.used.sum(-1, keepdims=True)
    start = np.where(kinks.used, kinks.azimuth(), 0.0)
    end = np.roll(start, -1, axis=-1)
    np.put_along_axis(end, np.maximum(number, 1) - 1, start[..., :1] + 2.0 * np.pi, -1)
    length = np.where(np.arange(MOST_ARCS) < np.maximum(number, 1), end - start, 0.0)
    return start, length


def find_arcs(lens: AimedLens, picks: NodePicks, centre: FloatArray, stars: IntArray) -> Arcs:
    """Outlines of stars whose beams are cut.

    Stars with no outline or too many kinks are left out, or where nodes are interpolated between such with other kinks.
    """
    # centre (n, b, 2), stars (s,)
    azimuth = np.tile(_coarse_azimuth(), (picks.count, 1))
    rims = OutlineSearch(lens, picks.kernel, centre[stars], picks.wavelength_nm, azimuth, stars).rims()
    kinks, good = _coarse_kinks(rims.height)
    for _ in range(NARROWINGS):
        narrower = kinks.azimuth()
        refined = OutlineSearch(lens, picks.kernel, centre[stars], picks.wavelength_nm, narrower, stars).rims()
        kinks = kinks.narrowed(narrower, refined.height)
    start, length = _between(kinks)
    if not picks.every:
        good = good & kinks.alike()
    good = np.asarray(good.all((1, 2)) & rims.good.all((1, 2, 3)))
    return Arcs(
        lens=lens,
        picks=picks,
        stars=stars[good],
        centre=centre[stars[good]],
        radius=rims.radius[good],
        start=start[good],
        length=length[good],
    )
