"""Cosmic rays in the detector: straight tracks of fast nuclei through the sensitive silicon.

The flux is isotropic. Through a flat layer, from both sides, go flux / 2 particles per area and time, where flux is the
omnidirectional one (4 pi times the intensity: particles through a sphere of unit cross section); cos^2 of their angles
to the normal is uniform, and their mean path is twice the depth. A track longer than the diagonal of the detector is
shortened to it. The middle of every track lies on the detector; what sticks out is lost.

Along each track `render.detector.ionisation_loss` draws collisions at uniform places; each frees energy / 3.65 eV
electrons, which spread by the detector's charge diffusion and are collected by its pixels. Electrons that diffuse up
from deeper silicon, nuclear reactions, secondaries from the spacecraft and the Fano noise of a collision are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from optics.arrays import FloatArray
from optics.errors import DomainError, unknown_name
from optics.records import freeze, locked
from render.detector.ionisation_loss import PAIR_ENERGY_EV, draw_collisions, knock_on_limit_ev
from render.detector.spec import Detector
from render.engine.random import Streams

_DEPTH_UM = (1.0, 500.0)
_LARGEST_HITS = 1e6
_CHUNK = 1 << 18


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CosmicRayEnvironment:
    """Particles of an environment and their flux."""

    # name, source: What it is and where its numbers come from
    name: str
    source: str
    flux_per_cm2_s: float  # Omnidirectional flux at the detector [cm^-2 s^-1]
    # nucleus_charge, nucleus_share: (c,) Charge numbers, and their shares in the particles
    nucleus_charge: FloatArray
    nucleus_share: FloatArray
    # energy_mev, energy_share: (k,) Kinetic energies per nucleon [MeV], and their shares, the same for all nuclei
    energy_mev: FloatArray
    energy_share: FloatArray

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "nucleus_charge", shape=("c",), sizes=sizes)
        energy = freeze(self, "energy_mev", shape=("k",), sizes=sizes)
        for name, size in (("nucleus_share", "c"), ("energy_share", "k")):
            weights = freeze(self, name, shape=(size,), sizes=sizes)
            if not (len(weights) and weights.min() >= 0 and weights.sum() > 0):
                raise DomainError(f"CosmicRayEnvironment.{name} must not be negative or zero everywhere")
            object.__setattr__(self, name, locked(weights / weights.sum()))
        if self.nucleus_charge.min() < 1:
            raise DomainError(
                f"CosmicRayEnvironment.nucleus_charge = {self.nucleus_charge.min():g}; at least 1 is needed"
            )
        if not 0.0 <= self.flux_per_cm2_s < math.inf:
            raise DomainError(
                f"CosmicRayEnvironment.flux_per_cm2_s = {self.flux_per_cm2_s:g} /cm2/s; it must not be negative"
            )
        if energy.min() < 10.0:
            raise DomainError(
                f"CosmicRayEnvironment.energy_mev contains {energy.min():g} MeV; at least 10 MeV is needed, slower "
                "particles stop"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CosmicRayHits:
    """Charge that cosmic rays leave in one frame, and the tracks behind it."""

    shape: tuple[int, int]  # Rows and columns of the detector
    # row, column: (m,) Pixels that collect charge, in the order of reading, none twice
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    charge_e: FloatArray  # (m,) Charge of all tracks together in each [e-]
    # x_px, y_px: (n,) Middle of each track (column, row)
    x_px: FloatArray
    y_px: FloatArray
    # azimuth_rad, cos_zenith: (n,) Direction: from +column towards +row, and against the normal of the detector
    azimuth_rad: FloatArray
    cos_zenith: FloatArray
    path_um: FloatArray  # (n,) Length in the sensitive silicon [um]
    # nucleus_charge, energy_mev: (n,) What it was; kinetic energy per nucleon [MeV]
    nucleus_charge: FloatArray
    energy_mev: FloatArray
    freed_e: FloatArray  # (n,) Electrons that each track freed, those lost over the edge included [e-]

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("row", "column"):
            index = freeze(self, name, shape=("m",), dtype=np.int64, sizes=sizes)
            if index.size and not (index.min() >= 0 and index.max() < self.shape[name == "column"]):
                raise DomainError(f"CosmicRayHits.{name} holds pixels outside the detector of {self.shape} px")
        charge = freeze(self, "charge_e", shape=("m",), sizes=sizes)
        if charge.size and charge.min() < 0:
            raise DomainError(f"CosmicRayHits.charge_e contains {charge.min():g} e-; charge must not be negative")
        for name in (
            "x_px", "y_px", "azimuth_rad", "cos_zenith", "path_um", "nucleus_charge", "energy_mev", "freed_e",
        ):  # fmt: skip
            freeze(self, name, shape=("n",), sizes=sizes)

    @property
    def hit_mask(self) -> NDArray[np.bool_]:
        """Pixels (h, w) with at least an electron."""
        mask = np.zeros(self.shape, np.bool_)
        counts = self.charge_e >= 1.0
        mask[self.row[counts], self.column[counts]] = True
        return mask

    def __len__(self) -> int:
        return len(self.x_px)


def list_environments() -> tuple[str, ...]:
    """Names that `cosmic_ray_environment` knows."""
    return tuple(_ENVIRONMENTS)


def cosmic_ray_environment(name: str) -> CosmicRayEnvironment:
    """Published environment by name."""
    if name not in _ENVIRONMENTS:
        raise unknown_name("cosmic-ray environment", name, _ENVIRONMENTS)
    return _ENVIRONMENTS[name]()


def cosmic_ray_hits(
    detector: Detector,
    environment: CosmicRayEnvironment | str,
    *,
    streams: Streams,
    frame: int,
    exposure_s: float,
    depth_um: float = 10.0,
) -> CosmicRayHits:
    """Hits of one frame, for ``expose(..., hits=...)``.

    ``exposure_s`` is the time in which charge is collected: exposure, and storage until it is read. The default
    thickness of the sensitive silicon (1 to 500 um) is that of the epitaxial layer of WFPC2's CCDs (WFPC2 Instrument
    Handbook, sec. 4.9); CMOS sensors have 2 to 20 um.
    """
    kind = cosmic_ray_environment(environment) if isinstance(environment, str) else environment
    if not 0.0 < exposure_s < math.inf:
        raise DomainError(f"exposure_s = {exposure_s:g} s; it must be positive and finite")
    if not _DEPTH_UM[0] <= depth_um <= _DEPTH_UM[1]:
        raise DomainError(f"depth_um = {depth_um:g} um; it must be {_DEPTH_UM[0]:g} to {_DEPTH_UM[1]:g} um")
    generator = streams.child("cosmic rays").generator("tracks", frame)
    height, width = detector.shape
    pitch_um = 1e3 * detector.pixel_pitch_mm
    expected = 0.5 * kind.flux_per_cm2_s * height * width * pitch_um**2 * 1e-8 * exposure_s
    if expected > _LARGEST_HITS:
        raise DomainError(
            f"{expected:.3g} cosmic rays are expected in {exposure_s:g} s; at most {_LARGEST_HITS:g} are drawn"
        )
    count = int(generator.poisson(expected))
    x, y = generator.uniform(-0.5, width - 0.5, count), generator.uniform(-0.5, height - 0.5, count)
    azimuth = generator.uniform(-math.pi, math.pi, count)
    shortest = min(1.0, depth_um / (math.hypot(height, width) * pitch_um))
    cosine = np.maximum(np.sqrt(1.0 - generator.random(count)), shortest)
    path = depth_um / cosine
    energy = generator.choice(kind.energy_mev, count, p=kind.energy_share)
    charge = generator.choice(kind.nucleus_charge, count, p=kind.nucleus_share)
    collisions = draw_collisions(path, energy, charge, limit_ev=knock_on_limit_ev(depth_um), generator=generator)
    along = generator.uniform(-0.5, 0.5, len(collisions.track)) * (depth_um / pitch_um)
    tangent = (np.sqrt(1.0 - cosine**2) / cosine)[collisions.track]
    electrons = collisions.energy_ev / PAIR_ENERGY_EV
    pixel, collected = _collected(
        x[collisions.track] + along * tangent * np.cos(azimuth)[collisions.track],
        y[collisions.track] + along * tangent * np.sin(azimuth)[collisions.track],
        electrons,
        detector,
    )
    return CosmicRayHits(
        shape=detector.shape,
        row=pixel // width,
        column=pixel % width,
        charge_e=collected,
        x_px=x,
        y_px=y,
        azimuth_rad=azimuth,
        cos_zenith=cosine,
        path_um=path,
        nucleus_charge=charge,
        energy_mev=energy,
        freed_e=np.bincount(collisions.track, electrons, count).astype(np.float64),
    )


def _collected(
    x: FloatArray, y: FloatArray, electrons: FloatArray, detector: Detector
) -> tuple[NDArray[np.int64], FloatArray]:
    """(pixel index, charge) of point charges that spread by diffusion; nothing in gaps."""
    sigma = detector.diffusion_sigma_px
    reach = math.ceil(5.0 * sigma) if sigma > 0 else 0
    height, width = detector.shape
    period = detector.chip_width_px + detector.gap_px
    indices: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    charges: list[FloatArray] = [np.zeros(0)]
    for start in range(0, len(x), _CHUNK // (2 * reach + 1) ** 2 + 1):
        part = slice(start, start + _CHUNK // (2 * reach + 1) ** 2 + 1)
        column, across = _shares(x[part], sigma, reach)
        row, down = _shares(y[part], sigma, reach)
        charge = electrons[part, None, None] * down[:, :, None] * across[:, None, :]
        inside = ((row >= 0) & (row < height))[:, :, None] & ((column >= 0) & (column < width))[:, None, :]
        inside &= (column % period < detector.chip_width_px)[:, None, :]
        index = row[:, :, None] * width + column[:, None, :]
        unique, at = np.unique(index[inside], return_inverse=True)
        indices.append(unique)
        charges.append(np.bincount(at, charge[inside], len(unique)).astype(np.float64))
    pixel, at = np.unique(np.concatenate(indices), return_inverse=True)
    total = np.bincount(at, np.concatenate(charges), len(pixel)).astype(np.float64)
    charged = total > 1e-3
    return pixel[charged].astype(np.int64), total[charged]


def _shares(x: FloatArray, sigma: float, reach: int) -> tuple[NDArray[np.int64], FloatArray]:
    """Pixels (m, 2 reach + 1) around points, and the part of a Gaussian that falls into each."""
    pixel = np.floor(x + 0.5).astype(np.int64)[:, None] + np.arange(-reach, reach + 1)
    if reach == 0:
        return pixel, np.ones(pixel.shape)
    edge = np.concatenate([pixel - 0.5, pixel[:, -1:] + 0.5], axis=1)
    return pixel, np.diff(ndtr((edge - x[:, None]) / sigma), axis=1)


# ---------------------------------------------------------------- published environments

# Simpson 1983, Ann. Rev. Nucl. Part. Sci. 33, 323: 87 % hydrogen, 12 % helium, 1 % heavier; oxygen stands for those
_GALACTIC_CHARGE, _GALACTIC_SHARE = np.array([1.0, 2.0, 8.0]), np.array([0.87, 0.12, 0.01])
_ROBBERTO = "Robberto 2009, JWST-STScI-001928, table 1: omnidirectional flux behind 2.5 mm of aluminium"


def _modulated(energy_mev: FloatArray, potential_mv: float) -> FloatArray:
    """Galactic protons near the Earth, relative: interstellar spectrum of Burger et al. (2000) in the force field.

    Usoskin et al. 2005, J. Geophys. Res. 110, A12108, eq. 1 and 2.
    """
    rest = 0.938
    outside = (energy_mev + potential_mv) / 1e3
    rigidity = np.sqrt(outside * (outside + 2.0 * rest))
    spectrum = rigidity**-2.78 / (1.0 + 0.4866 * rigidity**-2.51)
    near = energy_mev / 1e3
    return np.asarray(spectrum * near * (near + 2.0 * rest) / (outside * (outside + 2.0 * rest)))


def _galactic(name: str, flux: float, potential_mv: float) -> CosmicRayEnvironment:
    energy = np.geomspace(25.0, 50e3, 48)  # what 2.5 mm of aluminium let through, and beyond 50 GeV one in a thousand
    return CosmicRayEnvironment(
        name=name,
        source=f"{_ROBBERTO}; energies: Usoskin et al. 2005 at {potential_mv:g} MV; nuclei: Simpson 1983",
        flux_per_cm2_s=flux,
        nucleus_charge=_GALACTIC_CHARGE,
        nucleus_share=_GALACTIC_SHARE,
        energy_mev=energy,
        energy_share=_modulated(energy, potential_mv) * energy,  # equal steps of the logarithm
    )


def _protons(name: str, source: str, flux: float, energy_mev: FloatArray, share: FloatArray) -> CosmicRayEnvironment:
    return CosmicRayEnvironment(
        name=name,
        source=source,
        flux_per_cm2_s=flux,
        nucleus_charge=np.ones(1),
        nucleus_share=np.ones(1),
        energy_mev=energy_mev,
        energy_share=share,
    )


def _flare() -> CosmicRayEnvironment:
    energy = np.arange(31.0, 250.0, 4.0)
    source = f"{_ROBBERTO}; energies: King 1974, J. Spacecraft 11, 401, exp(-E / 26.5 MeV) above 30 MeV"
    return _protons("solar_flare", source, 3046.83, energy, np.exp(-energy / 26.5))


def _leo() -> CosmicRayEnvironment:
    source = (
        "HST Data Handbook, WF/PC-1, sec. 46.5: 1.7 events/s per CCD of 800 x 800 px of 15 um (1.44 cm2), twice that "
        "as flux; energy: Miles et al. 2021, ApJ 918, 86, 534 MeV"
    )
    return _protons("leo_quiet", source, 2.0 * 1.7 / 1.44, np.array([534.0]), np.ones(1))


_ENVIRONMENTS: dict[str, Callable[[], CosmicRayEnvironment]] = {
    "deep_space_solar_minimum": lambda: _galactic("deep_space_solar_minimum", 4.8983, 400.0),
    "deep_space_solar_maximum": lambda: _galactic("deep_space_solar_maximum", 1.7783, 1000.0),
    "solar_flare": _flare,
    "leo_quiet": _leo,
}
