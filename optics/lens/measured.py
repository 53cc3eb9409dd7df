r"""A measured lens without a prescription: positions, images and relative light of stars.

The file (TOML; `optics.export.write.write_measured_lens` writes it, `load_lens` reads it; keys without a default are
needed):

    kind = "measured"
    name = "35 mm F/1.9 no. 7"
    source = "eight night frames, ..."        # where the numbers come from
    date = "2019-07-28"                       # when it was measured
    reference_wavelength_nm = 600.0           # lateral colour is 0 there unless the tables say otherwise
    max_field_deg = 11.5                      # half field that was measured: the detector's corner

    [camera]                                  # docs/conventions.md, Distortion: ideal -> distorted
    focal_length_mm = 35.1
    principal_point_um = [12.0, -3.0]         # minus the centre of the detector, along columns and rows; default 0, 0
    q1_per_mm2 = -1.2e-4                      # q2_per_mm4, q3_per_mm6, p1_per_mm, p2_per_mm; default 0
    colour_nm = [500.0, 600.0, 750.0]         # lateral colour; default none
    colour_scale = [1.00001, 1.0, 0.99998]    # of distances from the principal point
    colour_shift_um = [[0.0, 0.1], [0.0, 0.0], [0.0, -0.1]]   # along columns and rows; default 0

    [psf]                                     # before the pixel
    includes_charge_diffusion = true          # default; false: that of the detector is added
    wavelength_nm = [500.0, 750.0]            # nodes of the tables; default: one, the same for all wavelengths
    x_mm = [-4.0, 0.0, 4.0]                   # on the detector from its centre, along columns; default [0]: everywhere
    y_mm = [-3.0, 0.0, 3.0]                   # along rows

    [[component]]                             # Gaussians of the PSF; a number, or [wavelength][y][x]
    share = 0.86                              # fraction of the light; all components add up to 1 (to 1e-6)
    sigma_x_um = [[[4.1, 4.0, 4.1], ...], ...]
    sigma_y_um = 4.4
    correlation = 0.0                         # of x and y, -1 ... 1, for oriented ellipses; default 0
    offset_x_um = 0.0                         # of its mean from the position by the camera model; default 0
    offset_y_um = 0.0

    [vignetting]                              # default: none
    radius_mm = [0.0, 2.0, 4.0]               # on the detector from the principal point
    relative_light = [1.0, 0.93, 0.66]        # of a star, all causes together; monotone cubics in between

    [throughput]
    aperture_mm = 18.4                        # diameter of the entrance pupil
    wavelength_nm = [400.0, 600.0, 1000.0]
    transmission = [0.8, 0.93, 0.9]           # on the axis; 0 ... 1, linear in between

Between nodes fractions, offsets and covariances are linear; beyond the outer nodes they are constant. A class of
stars (5040 K / T) enters by its effective wavelength: positions and variances are linear in the light, so that a table
that is linear in wavelength gives the class its mean. A sampled PSF is a mixture too: one narrow Gaussian per sample,
with its offset.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, FiniteFloat
from scipy.interpolate import PchipInterpolator

from optics.arrays import FloatArray
from optics.distortion_polynomial import COEFFICIENTS, distort, one_to_one_radius_mm
from optics.errors import DomainError
from optics.interpolation import bracket
from optics.records import freeze, freeze_all, locked
from optics.response import Response
from optics.units import UM_MM
from optics.validate import Positive, StrictTable, parse_model

ROUNDING = 1e-6
"""Tolerance of the sum of the components' fractions; they are scaled to 1."""
WIDEST_CORRELATION = 0.95
FIELD_MARGIN = 1.02
"""Ratio of the field for which a distortion holds to the measured one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GaussianMixture:
    """PSF before the pixel: k Gaussians at w wavelengths and on a grid of r by c positions on the detector."""

    wavelength_nm: FloatArray  # (w,) Nodes, increasing
    y_mm: FloatArray  # (r,) Positions along rows and columns from the centre of the detector
    x_mm: FloatArray  # (c,)
    share: FloatArray  # (w, r, c, k) Fraction of the light in each Gaussian
    offset_mm: FloatArray  # (w, r, c, k, 2) Mean from the position of the star, along columns and rows
    covariance_mm2: FloatArray  # (w, r, c, k, 3) Variance along columns, along rows, and covariance

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name, size in (("wavelength_nm", "w"), ("y_mm", "r"), ("x_mm", "c")):
            if not (np.diff(freeze(self, name, shape=(size,), sizes=sizes)) > 0).all():
                raise DomainError(f"psf.{name} = {getattr(self, name).tolist()}; increasing numbers are needed")
        share = freeze(self, "share", shape=("w", "r", "c", "k"), sizes=sizes)
        freeze(self, "offset_mm", shape=("w", "r", "c", "k", 2), sizes=sizes)
        xx, yy, xy = np.moveaxis(freeze(self, "covariance_mm2", shape=("w", "r", "c", "k", 3), sizes=sizes), -1, 0)
        total = share.sum(-1)
        if (share < 0.0).any() or np.abs(total - 1.0).max() > ROUNDING:
            worst = total.flat[int(np.abs(total - 1.0).argmax())]
            raise DomainError(
                f"component: shares from {share.min():g}, with a sum of {worst:.9g}; they must not be negative and "
                "add up to 1"
            )
        if not ((xx > 0.0) & (yy > 0.0) & (np.abs(xy) <= WIDEST_CORRELATION * np.sqrt(np.abs(xx * yy)))).all():
            raise DomainError(
                "component: sigma_x_um and sigma_y_um must be positive, correlation within "
                f"-{WIDEST_CORRELATION:g} ... {WIDEST_CORRELATION:g}"
            )
        object.__setattr__(self, "share", locked(share / total[..., None]))

    @property
    def narrowest_mm2(self) -> float:
        """Least variance in any direction of any of the Gaussians."""
        xx, yy, xy = np.moveaxis(self.covariance_mm2, -1, 0)
        return float((0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)).min())

    def at(
        self, x_mm: FloatArray, y_mm: FloatArray, wavelength_nm: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Fractions (..., k), offsets (..., k, 2), covariances (..., k, 3) at positions from the centre."""
        table = np.concatenate([self.share[..., None], self.offset_mm, self.covariance_mm2], axis=-1)
        at = np.broadcast_arrays(wavelength_nm, y_mm, x_mm)
        mean = np.zeros((*at[0].shape, *table.shape[3:]))
        nodes = (self.wavelength_nm, self.y_mm, self.x_mm)
        for corner in product(*(bracket(axis, position) for axis, position in zip(nodes, at, strict=True))):
            index, weight = zip(*corner, strict=True)
            mean += np.prod(np.broadcast_arrays(*weight), axis=0)[..., None, None] * table[index]
        return mean[..., 0], mean[..., 1:3], mean[..., 3:]

    def moments(self, x_mm: FloatArray, y_mm: FloatArray, wavelength_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean offset (..., 2) [mm] and covariance (..., 3) [mm^2] of all light."""
        share, offset, covariance = self.at(x_mm, y_mm, wavelength_nm)
        mean = (share[..., None] * offset).sum(-2)
        x, y = np.moveaxis(offset - mean[..., None, :], -1, 0)
        products = np.stack([x**2, y**2, x * y], axis=-1)
        return mean, np.asarray((share[..., None] * (covariance + products)).sum(-2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredLens:
    """A measured lens; its file format is in the module's docstring."""

    name: str
    source: str  # Where its numbers come from
    date: str  # When it was measured
    focal_length_mm: float  # Of the camera model
    principal_point_mm: FloatArray  # (2,) Minus the centre of the detector, along columns and rows
    distortion: FloatArray  # (5,) Coefficients of `optics.distortion_polynomial`
    colour_nm: FloatArray  # (c,) Lateral colour: scale of the distances from the principal point, and shift
    colour_scale: FloatArray  # (c,)
    colour_shift_mm: FloatArray  # (c, 2)
    psf: GaussianMixture  # Before the pixel
    includes_charge_diffusion: bool  # Whether the PSF holds the charge diffusion of the detector
    vignetting_mm: FloatArray  # (v,) Distance of an image from the principal point
    relative_light: FloatArray  # (v,) Light of a star there, relative to the axis
    aperture_mm: float  # Diameter of the entrance pupil
    transmission: Response  # On the axis
    reference_wavelength_nm: float  # Of chief rays
    max_field_deg: float  # Half field that was measured

    def __post_init__(self) -> None:
        for name in ("focal_length_mm", "aperture_mm", "reference_wavelength_nm"):
            if not (getattr(self, name) > 0.0 and math.isfinite(getattr(self, name))):
                raise DomainError(f"{name} = {getattr(self, name)}; it must be positive and finite")
        freeze_all(self, principal_point_mm=(2,), distortion=(len(COEFFICIENTS),))
        sizes: dict[str, int] = {}
        colour = freeze(self, "colour_nm", shape=("c",), sizes=sizes)
        freeze_all(self, colour_scale=("c",), colour_shift_mm=("c", 2), sizes=sizes)
        radius = freeze(self, "vignetting_mm", shape=("v",), sizes=sizes)
        light = freeze(self, "relative_light", shape=("v",), sizes=sizes)
        for name, nodes in (("camera.colour_nm", colour), ("vignetting.radius_mm", radius)):
            if not (np.diff(nodes) > 0.0).all():
                raise DomainError(f"{name} = {nodes.tolist()}; increasing numbers are needed")
        if len(colour) and (self.colour_scale <= 0.0).any():
            raise DomainError(f"camera.colour_scale = {self.colour_scale.tolist()}; positive numbers are needed")
        if len(light) == 1 or (len(light) and (radius[0] != 0.0 or light[0] <= 0.0 or (light < 0.0).any())):
            raise DomainError(
                f"vignetting: relative_light {light.tolist()} at radius_mm {radius.tolist()}; at least two points are "
                "needed, the first at 0, no light negative"
            )

    def position_mm(self, direction: FloatArray, wavelength_nm: FloatArray | float | None = None) -> FloatArray:
        """Positions of star images from the centre of the detector along columns and rows (..., 2) [mm], float64.

        Shapes: ``direction`` (..., 3) in cam, Z > 0, of any length; ``wavelength_nm`` broadcasts with it, the reference
        wavelength if left out. NaN beyond the field in which the distortion is known to be one-to-one.
        """
        wave = np.asarray(self.reference_wavelength_nm if wavelength_nm is None else wavelength_nm, float)
        v = np.asarray(direction, float)
        x, y = (self.focal_length_mm * v[..., i] / v[..., 2] for i in range(2))
        inside = np.hypot(x, y) <= self.reach_mm
        x, y = distort(x, y, self.distortion)
        if len(self.colour_nm):
            brackets = bracket(self.colour_nm, wave)
            scale = sum(weight * self.colour_scale[at] for at, weight in brackets)
            shift: Any = sum(weight[..., None] * self.colour_shift_mm[at] for at, weight in brackets)
            x, y = scale * x + shift[..., 0], scale * y + shift[..., 1]
        x, y, inside = np.broadcast_arrays(x, y, inside)
        return np.where(inside[..., None], np.stack([x, y], axis=-1) + self.principal_point_mm, np.nan)

    @property
    def reach_mm(self) -> float:
        """Undistorted distance from the principal point up to which stars are imaged; beyond it they give no light."""
        measured = self.focal_length_mm * math.tan(math.radians(min(FIELD_MARGIN * self.max_field_deg, 89.0)))
        return max(measured, one_to_one_radius_mm(self.distortion))

    def relative(self, position_mm: FloatArray) -> FloatArray:
        """Light of stars at positions (..., 2) of `position_mm`, relative to the axis; 0 where the position is NaN."""
        radius = np.linalg.norm(position_mm - self.principal_point_mm, axis=-1)
        light = np.ones(radius.shape)
        if len(self.vignetting_mm):
            curve = PchipInterpolator(self.vignetting_mm, self.relative_light)
            light = np.asarray(curve(np.minimum(radius, self.vignetting_mm[-1])))
        return np.where(np.isfinite(radius), light, 0.0)


Table = FiniteFloat | list[list[list[FiniteFloat]]]
"""A number that holds everywhere, or one per wavelength, row and column of the nodes."""


class _Camera(StrictTable):
    focal_length_mm: Positive
    principal_point_um: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    q1_per_mm2: FiniteFloat = 0.0
    q2_per_mm4: FiniteFloat = 0.0
    q3_per_mm6: FiniteFloat = 0.0
    p1_per_mm: FiniteFloat = 0.0
    p2_per_mm: FiniteFloat = 0.0
    colour_nm: tuple[FiniteFloat, ...] = ()
    colour_scale: tuple[FiniteFloat, ...] | None = None
    colour_shift_um: tuple[tuple[FiniteFloat, FiniteFloat], ...] | None = None


class _Psf(StrictTable):
    includes_charge_diffusion: bool = True
    wavelength_nm: tuple[Positive, ...] | None = None
    x_mm: tuple[FiniteFloat, ...] = (0.0,)
    y_mm: tuple[FiniteFloat, ...] = (0.0,)


class _Component(StrictTable):
    share: Table
    sigma_x_um: Table
    sigma_y_um: Table
    correlation: Table = 0.0
    offset_x_um: Table = 0.0
    offset_y_um: Table = 0.0


class _Vignetting(StrictTable):
    radius_mm: tuple[FiniteFloat, ...]
    relative_light: tuple[FiniteFloat, ...]


class _Throughput(StrictTable):
    aperture_mm: Positive
    wavelength_nm: tuple[FiniteFloat, ...]
    transmission: tuple[FiniteFloat, ...]


class _MeasuredFile(StrictTable):
    kind: Literal["measured"] = "measured"
    name: Annotated[str, Field(min_length=1)]
    source: Annotated[str, Field(min_length=1)]
    date: Annotated[str, Field(min_length=1)]
    reference_wavelength_nm: Positive
    max_field_deg: Annotated[FiniteFloat, Field(gt=0, lt=90)]
    camera: _Camera
    psf: _Psf = _Psf()
    component: Annotated[list[_Component], Field(min_length=1)]
    vignetting: _Vignetting | None = None
    throughput: _Throughput


def measured_from_table(table: Mapping[str, Any], where: str) -> MeasuredLens:
    """Measured lens of the tables of a file; `ConfigError` or `DomainError` name a key that is wrong."""
    file = parse_model(_MeasuredFile, table, where)
    camera, throughput, vignetting = file.camera, file.throughput, file.vignetting
    count = len(camera.colour_nm)
    try:
        return MeasuredLens(
            name=file.name,
            source=file.source,
            date=file.date,
            focal_length_mm=camera.focal_length_mm,
            principal_point_mm=np.array(camera.principal_point_um) * UM_MM,
            distortion=np.array([getattr(camera, name) for name in COEFFICIENTS]),
            colour_nm=np.array(camera.colour_nm),
            colour_scale=np.array([1.0] * count if camera.colour_scale is None else camera.colour_scale),
            colour_shift_mm=np.array(camera.colour_shift_um or np.zeros((count, 2))).reshape(-1, 2) * UM_MM,
            psf=_mixture(file),
            includes_charge_diffusion=file.psf.includes_charge_diffusion,
            vignetting_mm=np.array([] if vignetting is None else vignetting.radius_mm),
            relative_light=np.array([] if vignetting is None else vignetting.relative_light),
            aperture_mm=throughput.aperture_mm,
            transmission=Response(
                name=f"transmission of {file.name}",
                source=file.source,
                wavelength_nm=np.array(throughput.wavelength_nm),
                value=np.array(throughput.transmission),
            ),
            reference_wavelength_nm=file.reference_wavelength_nm,
            max_field_deg=file.max_field_deg,
        )
    except DomainError as error:
        raise DomainError(f"{where}: {error}") from None


def _mixture(file: _MeasuredFile) -> GaussianMixture:
    """The PSF of a file."""
    nodes = (file.psf.wavelength_nm or [file.reference_wavelength_nm], file.psf.y_mm, file.psf.x_mm)
    shape = tuple(map(len, nodes))

    def table(component: int, name: str) -> FloatArray:
        try:
            values = np.array(getattr(file.component[component], name), float)
        except ValueError:
            values = np.empty(0)
        if values.ndim and values.shape != shape:
            raise DomainError(
                f"component.{component}.{name}: a number, or a table of {shape[0]} wavelengths x {shape[1]} rows x "
                f"{shape[2]} columns is needed, as many as psf.wavelength_nm, psf.y_mm and psf.x_mm have"
            )
        return np.broadcast_to(values, shape)

    def each(name: str) -> FloatArray:
        return np.stack([table(k, name) for k in range(len(file.component))], axis=-1)

    x, y = each("sigma_x_um") * UM_MM, each("sigma_y_um") * UM_MM
    if min(x.min(), y.min()) <= 0.0:
        raise DomainError("component: sigma_x_um and sigma_y_um must be positive")
    return GaussianMixture(
        wavelength_nm=np.array(nodes[0]),
        y_mm=np.array(nodes[1]),
        x_mm=np.array(nodes[2]),
        share=each("share"),
        offset_mm=np.stack([each("offset_x_um"), each("offset_y_um")], axis=-1) * UM_MM,
        covariance_mm2=np.stack([x * x, y * y, each("correlation") * x * y], axis=-1),
    )


def measured_table(lens: MeasuredLens) -> dict[str, Any]:
    """Tables of the file of a measured lens; `measured_from_table` makes the same lens of them, to rounding."""
    psf = lens.psf
    sigma = np.sqrt(psf.covariance_mm2[..., :2]) / UM_MM
    correlation = psf.covariance_mm2[..., 2] / np.prod(np.sqrt(psf.covariance_mm2[..., :2]), axis=-1)
    values = {
        "share": psf.share,
        "sigma_x_um": sigma[..., 0],
        "sigma_y_um": sigma[..., 1],
        "correlation": correlation,
        "offset_x_um": psf.offset_mm[..., 0] / UM_MM,
        "offset_y_um": psf.offset_mm[..., 1] / UM_MM,
    }
    camera = {
        "focal_length_mm": lens.focal_length_mm,
        "principal_point_um": (lens.principal_point_mm / UM_MM).tolist(),
        **dict(zip(COEFFICIENTS, lens.distortion.tolist(), strict=True)),
    }
    if len(lens.colour_nm):
        camera["colour_nm"] = lens.colour_nm.tolist()
        camera["colour_scale"] = lens.colour_scale.tolist()
        camera["colour_shift_um"] = (lens.colour_shift_mm / UM_MM).tolist()
    table: dict[str, Any] = {
        "kind": "measured",
        "name": lens.name,
        "source": lens.source,
        "date": lens.date,
        "reference_wavelength_nm": lens.reference_wavelength_nm,
        "max_field_deg": lens.max_field_deg,
        "camera": camera,
        "psf": {
            "includes_charge_diffusion": lens.includes_charge_diffusion,
            "wavelength_nm": psf.wavelength_nm.tolist(),
            "x_mm": psf.x_mm.tolist(),
            "y_mm": psf.y_mm.tolist(),
        },
        "component": [
            {name: _short(value[..., k]) for name, value in values.items()} for k in range(psf.share.shape[-1])
        ],
    }
    if len(lens.vignetting_mm):
        table["vignetting"] = {
            "radius_mm": lens.vignetting_mm.tolist(),
            "relative_light": lens.relative_light.tolist(),
        }
    table["throughput"] = {
        "aperture_mm": lens.aperture_mm,
        "wavelength_nm": lens.transmission.wavelength_nm.tolist(),
        "transmission": lens.transmission.value.tolist(),
    }
    return table


def _short(values: FloatArray) -> Any:
    """A number where all are the same."""
    return float(values.flat[0]) if np.ptp(values) == 0.0 else values.tolist()
