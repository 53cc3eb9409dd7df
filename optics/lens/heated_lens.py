"""Lens and housing in a temperature field: expansion, index, spacers at the rim, bending, gradients in glass.

One field, linear in the state, with z from the front of the lens to its image plane (length L), x and y across the
housing (diameter D), r from the axis of an element that ends at R:

    dT = mean + axial (z / L - 1/2) + (transverse_x x + transverse_y y) / D,   in glass also + radial (r^2 / R^2 - 1/2)

* Every element has the temperature of its middle: index (at all wavelengths), radii, thickness.
* Air gaps follow their spacers, at the temperature of their middle. A spacer that touches a face at a radius, where the
  face lies at its sag and not at its vertex, moves along the face as it grows.
* A transverse gradient bends the housing: curvature alpha dT / D, away from the warm side, from the plane at which the
  sensor is mounted. Elements and image plane follow as rigid bodies. An element also becomes a wedge, of thickness
  (alpha t) and of index; the latter is that of a tilted last face with the same deviation at the design wavelength.
* A radial gradient makes an element a lens, n(r) and thickness t(r) = t [1 + alpha (1 + nu) dT(r)], that of a free
  thin disc without stress in its faces (Timoshenko and Goodier 1970, *Theory of Elasticity*, art. 150). The quadratic
  part is a change of the curvatures; that of the index, at the design wavelength, one of the outer faces with the same
  path.

Left out: stress-optic effects, the effects of the mounts' forces, the change of the air in the gaps with the gradient,
the bending of an element by the gradient along its own thickness, the dispersion of dn/dT within gradients across
glass, gradients within mirrors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import DomainError, unknown_name
from optics.glass.absolute_index import Environment
from optics.glass.air import kohlrausch_density
from optics.glass.catalogue import Glass
from optics.lens.shapes.base import Shape
from optics.lens.shapes.conic import Conic
from optics.lens.shapes.plane import Plane
from optics.lens.shapes.revolution import Curved
from optics.lens.shapes.sphere import Sphere
from optics.lens.system import AMBIENT, LensSystem, Surface

DETECTOR, STOP = "detector", "stop"
"""Names of spacers: in front of the image plane, and of a stop that belongs to no element."""
LARGEST_K = 250.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalState:
    """Temperature field minus the temperature of the lens [K]; states can be added and scaled.

    Attributes
    ----------
    mean_k : float
        Uniform part, of lens and housing.
    axial_k : float
        Temperature of the image plane minus that of the front, over the length between the outermost surfaces and image
        plane along z.
    transverse_x_k, transverse_y_k : float
        Temperature of the side towards +x (+y) of the lens frame minus that of the opposite side, over the diameter of
        the housing.
    radial_k : float
        Temperature of the rim minus that of the centre of every element, quadratic in the radius, with zero mean over
        the area.
    """

    mean_k: float = 0.0
    axial_k: float = 0.0
    transverse_x_k: float = 0.0
    transverse_y_k: float = 0.0
    radial_k: float = 0.0

    def __post_init__(self) -> None:
        for name in COMPONENTS:
            value = getattr(self, name)
            if not abs(value) <= LARGEST_K:
                raise DomainError(f"ThermalState.{name} = {value} K; it must lie within +-{LARGEST_K:g} K")

    def __add__(self, other: ThermalState) -> ThermalState:
        return ThermalState.of(self.vector + other.vector)

    def __mul__(self, factor: float) -> ThermalState:
        return ThermalState.of(self.vector * factor)

    __rmul__ = __mul__

    @property
    def vector(self) -> FloatArray:
        """The components (5,) in the order of `COMPONENTS` [K]."""
        return np.array([getattr(self, name) for name in COMPONENTS], float)

    @staticmethod
    def of(vector: FloatArray) -> ThermalState:
        """State of its components (5,) in the order of `COMPONENTS` [K]."""
        return ThermalState(**dict(zip(COMPONENTS, (float(v) for v in vector), strict=True)))


COMPONENTS = ("mean_k", "axial_k", "transverse_x_k", "transverse_y_k", "radial_k")


@dataclass(frozen=True, slots=True, kw_only=True)
class Mount:
    """Contact radii of the spacers on an element.

    Attributes
    ----------
    front_radius_mm : float
        Radius of contact on the front face [mm]; 0: at the vertex.
    back_radius_mm : float
        The same on the back face.
    """

    front_radius_mm: float = 0.0
    back_radius_mm: float = 0.0

    def __post_init__(self) -> None:
        for name in ("front_radius_mm", "back_radius_mm"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise DomainError(f"Mount.{name} = {getattr(self, name)} mm; it must be finite and not negative")


@dataclass(frozen=True, slots=True, kw_only=True)
class Housing:
    """Housing of a lens: expansion, diameter, spacers and mounting plane.

    Attributes
    ----------
    expansion_per_k : float
        Linear expansion of barrel and spacers [1/K].
    diameter_mm : float or None
        Distance across which transverse gradients are stated; the widest clear aperture if None.
    mounted_z_mm : float or None
        Mounting plane in the lens frame, fixed when the housing bends; the image plane if None.
    mounts : dict of str to Mount
        Contact radii per element; elements not named are held at their vertices.
    spacers_per_k : dict of str to float
        Linear expansion [1/K] of single spacers, by the element behind them (`STOP`, `DETECTOR`).
    poisson_ratio : float
        Poisson's ratio of the glasses (0.19 to 0.31).
    """

    expansion_per_k: float
    diameter_mm: float | None = None
    mounted_z_mm: float | None = None
    mounts: Mapping[str, Mount] = field(default_factory=dict)
    spacers_per_k: Mapping[str, float] = field(default_factory=dict)
    poisson_ratio: float = 0.25

    def __post_init__(self) -> None:
        for name, value in (("expansion_per_k", self.expansion_per_k), *self.spacers_per_k.items()):
            if not abs(value) <= 1e-2:
                raise DomainError(f"expansion of the housing, {name} = {value}/K; it must lie within +-0.01/K")
        if self.diameter_mm is not None and not 0.0 < self.diameter_mm < math.inf:
            raise DomainError(f"Housing.diameter_mm = {self.diameter_mm} mm; a positive number is needed")
        if not 0.0 <= self.poisson_ratio <= 0.5:
            raise DomainError(f"Housing.poisson_ratio = {self.poisson_ratio}; it must lie between 0 and 0.5")


def with_spacers(housing: Housing, **per_k: float) -> Housing:
    """The housing with other expansions [1/K] of the spacers in front of the named elements."""
    return replace(housing, spacers_per_k={**housing.spacers_per_k, **per_k})


@dataclass(frozen=True, slots=True)
class _Body:
    """Surfaces that glass holds together, or one surface in air; the image plane is the last body."""

    name: str
    first: int
    last: int
    z_mm: float  # Middle
    kelvin: float

    def __contains__(self, index: int) -> bool:
        return self.first <= index <= self.last


def expansion_of(lens: LensSystem, medium: str) -> float:
    """Linear expansion of a glass [1/K]; DomainError where it has none."""
    cte = lens.glasses[medium].cte_per_k
    if cte is None:
        raise DomainError(
            f"glass {medium} in lens {lens.name!r} has no expansion coefficient; give cte_per_k in the lens file"
        )
    return cte


class _Field:
    """The state on a lens: temperatures over z."""

    def __init__(self, lens: LensSystem, state: ThermalState, housing: Housing) -> None:
        z = np.array([position[2] for position, _ in lens.poses])
        self.front, self.length = float(z.min()), float(np.ptp(z)) or 1.0
        self.lens, self.state, self.housing = lens, state, housing
        self.bodies = self._bodies()
        names = {body.name for body in self.bodies}
        for name in (*housing.mounts, *housing.spacers_per_k):
            if name not in names:
                raise unknown_name("element or spacer", name, tuple(n for n in names if n))

    def kelvin(self, z_mm: float) -> float:
        """Temperature change on the axis at z [K]."""
        return self.state.mean_k + self.state.axial_k * ((z_mm - self.front) / self.length - 0.5)

    def _bodies(self) -> list[_Body]:
        lens, bodies, first = self.lens, [], 0
        for last, surface in enumerate(lens.surfaces):
            if surface.medium == AMBIENT or last == len(lens.surfaces) - 1:
                name = lens.surfaces[first].element or (STOP if surface.is_stop else "")
                bodies.append(self._body(name, first, last))
                first = last + 1
        return [*bodies, self._body(DETECTOR, first, first)]

    def _body(self, name: str, first: int, last: int) -> _Body:
        z = 0.5 * float(self.lens.poses[first][0][2] + self.lens.poses[last][0][2])
        return _Body(name, first, last, z, self.kelvin(z))

    def body(self, index: int) -> _Body:
        return next(body for body in self.bodies if index in body)

    def spacer(self, body: _Body) -> tuple[float, float]:
        """Expansion [1/K] and temperature change of the spacer in front of a body."""
        before, after = (self.lens.poses[i][0][2] for i in (max(body.first - 1, 0), body.first))
        expansion = self.housing.spacers_per_k.get(body.name, self.housing.expansion_per_k)
        return expansion, self.kelvin(0.5 * float(before + after))

    def radius_mm(self, body: _Body) -> float:
        """Radius of an element for radial gradients."""
        rims = [s.semi_diameter_mm for s in self.lens.surfaces[body.first : body.last + 1]]
        mount = self.housing.mounts.get(body.name, Mount())
        radii = [r for r in (*rims, mount.front_radius_mm, mount.back_radius_mm) if 0.0 < r < math.inf]
        if not radii:
            raise DomainError(
                f"radial gradient in lens {self.lens.name!r}: {self.lens.label(body.first)} has no clear aperture, "
                "so its radius is unknown; give semi_diameter_mm in the lens file"
            )
        return max(radii)

    @property
    def diameter_mm(self) -> float:
        if self.housing.diameter_mm is not None:
            return self.housing.diameter_mm
        widest = max((s.semi_diameter_mm for s in self.lens.surfaces if s.semi_diameter_mm < math.inf), default=0.0)
        if not widest:
            raise DomainError(
                f"transverse gradient: lens {self.lens.name!r} has no clear apertures; state the housing's diameter_mm"
            )
        return 2.0 * widest


def _expanded_surface(lens: LensSystem, index: int, vertex: FloatArray, kelvin: float, housing: float) -> Surface:
    """Surface at its new vertex, its shape expanded with the glass or the mirror it belongs to."""
    surface = lens.surfaces[index]
    before = lens.surfaces[index - 1].medium if index else AMBIENT
    ctes = [expansion_of(lens, m) for m in (before, surface.medium) if m != AMBIENT]
    if surface.cte_per_k is not None:
        ctes = [surface.cte_per_k]
    shape_cte = sum(ctes) / len(ctes) if ctes else housing
    growth = math.exp(shape_cte * kelvin)
    return replace(
        surface,
        shape=surface.shape.scaled(growth),
        position_mm=vertex,
        semi_diameter_mm=surface.semi_diameter_mm * growth,
        inner_semi_diameter_mm=surface.inner_semi_diameter_mm * growth,
        apertures=tuple(aperture.scaled(growth) for aperture in surface.apertures),
        error=None if surface.error is None else surface.error.scaled(growth),
    )


def heated_lens(
    lens: LensSystem, state: ThermalState, housing: Housing, *, pressure_hpa: float | None = None
) -> LensSystem:
    """The lens in a temperature field; its dimensions hold at the uniform temperature of its environment.

    A length L becomes L exp(cte dT), so that opposite uniform steps cancel exactly. A cemented surface
    expands by the mean of its two glasses, a mirror with its substrate (``Surface.cte_per_k``) or the housing. Shifts
    across the axis follow the housing.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    state : ThermalState
        The field.
    housing : Housing
        What holds the elements.
    pressure_hpa : float, optional
        New air pressure; unchanged if left out.

    Returns
    -------
    LensSystem
        A new lens, ready to be traced; ``lens`` itself if nothing changes.

    Raises
    ------
    DomainError
        If a glass has no expansion or dn/dT data, a temperature is out of its range, a mount does not touch its
        element, or a radial gradient meets a surface that is neither plane nor one of revolution on a conic.
    ConfigError
        If the housing names an element that the lens does not have.
    """
    lens.check_surfaces()
    thermal = _Field(lens, state, housing)
    environment = Environment(
        temperature_c=lens.environment.temperature_c + state.mean_k,
        pressure_hpa=lens.environment.pressure_hpa if pressure_hpa is None else pressure_hpa,
    )
    if not state.vector.any():
        return lens if environment == lens.environment else replace(lens, environment=environment)
    surfaces, image = _expanded(thermal)
    if state.radial_k:
        surfaces = _with_radial_gradient(thermal, surfaces)
    warmed = replace(lens, surfaces=surfaces, image_position_mm=image, environment=environment)
    if state.axial_k or state.radial_k:
        warmed = _glasses_at_temperature(thermal, warmed)
    if state.transverse_x_k or state.transverse_y_k:
        warmed = _bent_by_gradient(thermal, warmed)
    warmed.indices(lens.design_wavelength_nm)  # refuses glasses without dn/dT now, not at the first trace
    return warmed


def _expanded(thermal: _Field) -> tuple[tuple[Surface, ...], FloatArray]:
    """Surfaces grown and moved along the axis, and the place of the image plane."""
    lens, housing, state = thermal.lens, thermal.housing, thermal.state
    old, axis = [position for position, _ in lens.poses], lens.axis
    new = [old[0] * math.exp(housing.expansion_per_k * thermal.kelvin(float(old[0][2])))]
    surfaces: list[Surface] = []
    for i, surface in enumerate(lens.surfaces):
        body, start, end = thermal.body(i), old[i], old[i + 1]
        surfaces.append(_expanded_surface(lens, i, new[i], body.kelvin, housing.expansion_per_k))
        along = ((end - start) @ axis[i + 1]) * axis[i + 1]
        if i == body.last:
            behind = thermal.body(i + 1)
            expansion, kelvin = thermal.spacer(behind)
            step = along * math.exp(expansion * kelvin) + axis[i + 1] * _rim_contact_change(
                thermal, body, behind, surfaces[i]
            )
        else:
            expansion, kelvin = expansion_of(lens, surface.medium), body.kelvin
            centre = -0.5 * state.radial_k * (1.0 + housing.poisson_ratio)  # of a disc whose mean stays
            step = along * math.exp(expansion * (kelvin + centre))
        growth = math.exp(housing.expansion_per_k * kelvin)
        new.append(new[-1] + step + (end - start - along) * growth)
    return tuple(surfaces), new[-1]


def _rim_contact_change(thermal: _Field, front: _Body, behind: _Body, grown: Surface) -> float:
    """Change of a gap because its spacer touches faces away from the vertices [mm]."""
    lens = thermal.lens
    expansion, kelvin = thermal.spacer(behind)
    growth, change = math.exp(expansion * kelvin), 0.0
    touched = [(front, front.last, thermal.housing.mounts.get(front.name, Mount()).back_radius_mm, -1.0)]
    touched += [(behind, behind.first, thermal.housing.mounts.get(behind.name, Mount()).front_radius_mm, 1.0)]
    for body, index, radius, sign in touched:
        if not radius or index == len(lens.surfaces):
            continue
        new = grown
        if body is not front:
            new = _expanded_surface(lens, index, np.zeros(3), body.kelvin, thermal.housing.expansion_per_k)
        contacts = ((lens.surfaces[index], radius), (new, radius * growth))
        sags = [float(surface.shape.sag(np.array(r), np.zeros(()))) for surface, r in contacts]
        if not np.all(np.isfinite(sags)):
            raise DomainError(
                f"mount of {body.name} at radius {radius:g} mm: {lens.label(index)} ends inside this radius"
            )
        change += sign * (sags[0] * growth - sags[1])
    return change


def _glasses_at_temperature(thermal: _Field, lens: LensSystem) -> LensSystem:
    """Every element with glasses at its own temperature on the axis: the same ones, their reference moved."""
    surfaces, glasses = list(lens.surfaces), {}
    for i, surface in enumerate(lens.surfaces):
        if surface.medium != AMBIENT:
            body = thermal.body(i)
            kelvin = body.kelvin - thermal.state.mean_k - 0.5 * thermal.state.radial_k
            name = f"{surface.medium} of {body.name or lens.label(body.first)}"
            glasses[name] = _warmer(lens.glasses[surface.medium], name, kelvin)
            surfaces[i] = replace(surface, medium=name)
    return replace(lens, surfaces=tuple(surfaces), glasses=glasses)


def _warmer(glass: Glass, name: str, kelvin: float) -> Glass:
    """A glass warmer than the lens, in terms of the lens temperature."""
    reference = glass.reference_temperature_c
    ratio = kohlrausch_density(reference, 1.0) / kohlrausch_density(reference - kelvin, 1.0)
    dndt = glass.dndt
    if dndt is not None:
        dndt = replace(dndt, range_c=(dndt.range_c[0] - kelvin, dndt.range_c[1] - kelvin))
    return replace(
        glass,
        name=name,
        reference_temperature_c=reference - kelvin,
        reference_pressure_hpa=glass.reference_pressure_hpa * ratio,  # the air of its measurement stays
        dndt=dndt,
    )


def _index_slope(thermal: _Field, medium: str, kelvin: float) -> tuple[float, float]:
    """Index and dn/dT [1/K] of a glass against the air around, at the design wavelength."""
    lens, wave = thermal.lens, thermal.lens.design_wavelength_nm
    at = lens.environment.temperature_c + kelvin
    low, high = (float(lens.glasses[medium].absolute_index(wave, temperature_c=t)) for t in (at - 0.5, at + 0.5))
    air = float(lens.indices(wave)[0])
    return 0.5 * (low + high) / air, (high - low) / air


def _wedge(thermal: _Field, body: _Body) -> tuple[FloatArray, float, float]:
    """Change of the thicknesses (glasses,) of an element per K of a gradient [mm/K], and of the sag of its first and
    last face, each for half of the change of index."""
    lens = thermal.lens
    mechanical, path, index = [], 0.0, []
    for i in range(body.first, body.last):
        thickness = float(np.linalg.norm(lens.surfaces[i + 1].position_mm - lens.surfaces[i].position_mm))
        n, slope = _index_slope(thermal, lens.surfaces[i].medium, body.kelvin)
        mechanical.append(thickness * expansion_of(lens, lens.surfaces[i].medium))
        path += thickness * slope
        index.append(n)
    return np.array(mechanical), -0.5 * path / (index[0] - 1.0), 0.5 * path / (index[-1] - 1.0)


def _is_glass(lens: LensSystem, body: _Body) -> bool:
    """Whether a body refracts: glass from its first to its last surface, and no mirror."""
    return body.last > body.first and not any(s.mirror for s in lens.surfaces[body.first : body.last + 1])


def _with_radial_gradient(thermal: _Field, surfaces: tuple[Surface, ...]) -> tuple[Surface, ...]:
    """The surfaces with the quadratic part of a radial gradient in every element."""
    changed, state = list(surfaces), thermal.state
    for body in thermal.bodies:
        if not _is_glass(thermal.lens, body):
            continue
        quadratic = state.radial_k / thermal.radius_mm(body) ** 2
        grown, front, back = _wedge(thermal, body)
        sag = np.concatenate([[0.0], np.cumsum(grown)]) * (1.0 + thermal.housing.poisson_ratio)
        sag -= 0.5 * sag[-1]
        sag[0], sag[-1] = sag[0] + front, sag[-1] + back
        for i, sag_per_k in zip(range(body.first, body.last + 1), sag, strict=True):
            shape = _with_curvature(thermal.lens, i, changed[i].shape, 2.0 * float(sag_per_k) * quadratic)
            changed[i] = replace(changed[i], shape=shape)
    return tuple(changed)


def _with_curvature(lens: LensSystem, index: int, shape: Shape, by: float) -> Shape:
    """The shape with ``by r^2 / 2`` added to its sag; exact to the fourth order in r."""
    if by == 0.0:
        return shape
    if isinstance(shape, Plane):
        return Conic(radius_mm=1.0 / by, conic=-1.0)
    if not isinstance(shape, Curved):
        raise DomainError(
            f"radial gradient in lens {lens.name!r}: {lens.label(index)} is of kind {shape.kind}; it is modelled "
            "for planes and surfaces of revolution on a conic only"
        )
    old, new = shape.curvature, shape.curvature + by
    conic = (1.0 + float(getattr(shape, "conic", 0.0))) * (old / new) ** 3 - 1.0
    if isinstance(shape, Sphere):
        return Conic(radius_mm=1.0 / new, conic=conic)
    return replace(shape, radius_mm=1.0 / new, conic=conic)  # type: ignore[call-arg]


def _bent_by_gradient(thermal: _Field, lens: LensSystem) -> LensSystem:
    """The lens in a housing bent by a transverse gradient, its elements wedges."""
    gradient = np.array([thermal.state.transverse_x_k, thermal.state.transverse_y_k]) / thermal.diameter_mm
    surfaces = list(lens.surfaces)
    for body in thermal.bodies:
        slope, shift = (factor * gradient for factor in _deflection(thermal, body.z_mm))
        turn = _tilt(slope)
        middle = np.array([0.0, 0.0, 0.5 * (lens.poses[body.first][0][2] + lens.poses[body.last][0][2])])
        middle_after = middle + np.array([shift[0], shift[1], 0.0])
        if body.name == DETECTOR and body.first == len(surfaces):
            position = turn @ (lens.image_position_mm - middle) + middle_after
            lens = replace(lens, image_position_mm=position, image_rotation=turn @ lens.image_rotation)
            continue
        tilts = np.zeros(body.last - body.first + 1)
        along = float(np.sign(lens.poses[body.last][0][2] - lens.poses[body.first][0][2]))  # -1 behind a mirror
        if _is_glass(thermal.lens, body):
            grown, front, back = _wedge(thermal, body)
            tilts = np.concatenate([[0.0], np.cumsum(grown)]) - 0.5 * grown.sum()
            tilts[0], tilts[-1] = tilts[0] + front, tilts[-1] + back
        for i, tilt in zip(range(body.first, body.last + 1), tilts, strict=True):
            old = surfaces[i]
            surfaces[i] = replace(
                old,
                position_mm=turn @ (old.position_mm - middle) + middle_after,
                rotation=turn @ _tilt(-along * float(tilt) * gradient) @ old.rotation,
            )
    return replace(lens, surfaces=tuple(surfaces))


def _tilt(slope: FloatArray) -> FloatArray:
    """Rotation that tilts the z axis by slopes (2,) towards x and y."""
    return Rotation.from_rotvec([-slope[1], slope[0], 0.0]).as_matrix()


def _deflection(thermal: _Field, z_mm: float) -> tuple[float, float]:
    """Slope and deflection of the housing at z over the gradient [mm/K, mm^2/K]; both zero where it is held."""
    fixed = thermal.housing.mounted_z_mm
    start = float(thermal.lens.image_position_mm[2]) if fixed is None else fixed
    edges = sorted(
        {start, z_mm, *(float(p[2]) for p, _ in thermal.lens.poses if start < p[2] < z_mm or z_mm < p[2] < start)}
    )
    if z_mm < start:
        edges.reverse()
    slope = shift = 0.0
    for a, b in pairwise(edges):
        curvature = -_expansion_at(thermal, 0.5 * (a + b))
        shift += slope * (b - a) + 0.5 * curvature * (b - a) ** 2
        slope += curvature * (b - a)
    return slope, shift


def _expansion_at(thermal: _Field, z_mm: float) -> float:
    """Expansion of the housing at z: of the spacer in a gap, of the barrel elsewhere [1/K]."""
    spacers_per_k = thermal.housing.spacers_per_k
    for body in thermal.bodies[1:] if spacers_per_k else ():
        ends = sorted(float(thermal.lens.poses[i][0][2]) for i in (body.first - 1, body.first))
        if body.name in spacers_per_k and ends[0] <= z_mm <= ends[1]:
            return spacers_per_k[body.name]
    return thermal.housing.expansion_per_k
