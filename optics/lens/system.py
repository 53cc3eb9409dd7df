"""A lens as data: surfaces with their poses in the lens frame, media, stop, image plane.

Light enters towards +z of the lens frame and meets every surface and the image plane towards +z of their own frames:
behind an odd number of mirrors the frame of a surface is turned by 180 deg. The image plane keeps its x and y there:
columns are counted so that the picture is not mirrored, and its axes are left-handed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from optics.arrays import NUMPY, FloatArray
from optics.errors import ConfigError, DomainError, unknown_name
from optics.glass.absolute_index import CATALOGUE_AIR, Environment, IndexFormula, index_parameters
from optics.glass.catalogue import Glass
from optics.glass.coating import Coating, TabulatedCoating
from optics.lens.apertures import Aperture
from optics.lens.measured import MeasuredLens
from optics.lens.sag_map import SagMap
from optics.lens.shapes.base import Shape
from optics.lens.shapes.plane import Plane
from optics.records import freeze, freeze_all
from optics.response import Response, checked_wavelength

AMBIENT = "air"
"""Name of the medium that fills the surroundings, at any pressure (vacuum included)."""
HALF_TURN = np.diag([-1.0, 1.0, -1.0])
"""Half a turn about y; its own inverse."""
STOP_ALONE = "the stop"
"""What messages call a stop that is no surface of its file's list."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """One surface.

    Attributes
    ----------
    shape : Shape
        One of the kinds in `optics.lens.shapes.registry`.
    position_mm : (3,)
        Vertex in the lens frame.
    rotation : (3, 3)
        Columns are the surface's axes in the lens frame; identity for a centred surface.
    medium : str
        Medium behind the surface: a glass name or ``"air"``; for a mirror the medium in front of it.
    mirror : bool
        Whether it reflects.
    semi_diameter_mm : float
        Clear aperture measured in the vertex plane; infinite means unlimited.
    inner_semi_diameter_mm : float
        Radius of a central obscuration, 0 for none.
    apertures : tuple of Aperture
        Further outlines, all of which light has to pass.
    error : SagMap or None
        Measured deviation, added to the sag.
    cte_per_k : float or None
        Linear expansion of a mirror's substrate [1/K]; that of the housing if not given.
    element : str
        Name of the element (group) that moves as one.
    is_stop : bool
        Whether this is the aperture stop.
    index_offset : float
        Added to the index of what follows (melt tolerance).
    coating : Coating or None
        Coating; None: not stated (bare glass, or the instrument's coating; mirrors reflect all light).
    label : str
        Name in messages, such as ``"surface 4 (line 27)"``.
    """

    shape: Shape
    position_mm: FloatArray
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))
    medium: str = AMBIENT
    mirror: bool = False
    semi_diameter_mm: float = math.inf
    inner_semi_diameter_mm: float = 0.0
    apertures: tuple[Aperture, ...] = ()
    error: SagMap | None = None
    cte_per_k: float | None = None
    element: str = ""
    is_stop: bool = False
    index_offset: float = 0.0
    coating: Coating | None = None
    label: str = ""

    def __post_init__(self) -> None:
        freeze(self, "position_mm", shape=(3,))
        rotation = freeze(self, "rotation", shape=(3, 3))
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12) or np.linalg.det(rotation) < 0:
            raise DomainError("Surface.rotation is not a proper rotation matrix")
        if not self.semi_diameter_mm > 0:
            raise DomainError(f"Surface.semi_diameter_mm = {self.semi_diameter_mm} mm; it must be positive")
        if not 0 <= self.inner_semi_diameter_mm < self.semi_diameter_mm:
            raise DomainError(
                f"Surface.inner_semi_diameter_mm = {self.inner_semi_diameter_mm} mm; it must lie between 0 and the "
                f"semi-diameter {self.semi_diameter_mm} mm"
            )
        if self.mirror and self.coating is not None and not isinstance(self.coating, TabulatedCoating):
            raise ConfigError("the coating of a mirror is a table of its reflectance (kind = 'table')")

    @property
    def holed(self) -> bool:
        """Whether it blocks light other than beyond a circle about its vertex."""
        return self.inner_semi_diameter_mm > 0.0 or bool(self.apertures)

    def from_behind(self) -> Surface:
        """The same piece of matter in a frame turned by half a turn about y, for light that comes from its other side.

        Position, medium and element stay what they are.
        """
        return replace(
            self,
            shape=self.shape.flipped(),
            rotation=self.rotation @ HALF_TURN,
            apertures=tuple(aperture.flipped() for aperture in self.apertures),
            error=None if self.error is None else self.error.flipped(),
        )


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class LensSystem:
    """A lens prescription, ready to be traced, perturbed or drawn.

    Attributes
    ----------
    name, source : str
        What it is and where its numbers come from.
    surfaces : tuple of Surface
        In the order light meets them; the stop is one of them (alone: a plane without refraction).
    glasses : dict of str to Glass
        Every glass the surfaces name.
    image_position_mm : (3,)
        Origin of the image plane in the lens frame.
    image_rotation : (3, 3)
        Axes of the image plane, columns; left-handed behind an odd number of mirrors.
    design_wavelength_nm : float
        Reference wavelength for chief rays and paraxial quantities.
    max_field_deg : float
        Half field angle.
    environment : Environment
        Temperature and pressure.
    throughput : Response or None
        Stated axial transmission, in place of that of glasses and coatings.
    blur_um, blur_px : float
        Standard deviation of an additional Gaussian blur of the image, in either unit.
    measured : MeasuredLens or None
        Measured lens without known surfaces. ``surfaces`` are then of an ideal lens of its focal length and aperture,
        for first-order quantities; `check_surfaces` refuses to trace them.
    """

    name: str
    source: str
    surfaces: tuple[Surface, ...]
    glasses: dict[str, Glass]
    image_position_mm: FloatArray
    image_rotation: FloatArray = field(default_factory=lambda: np.eye(3))
    design_wavelength_nm: float
    max_field_deg: float
    environment: Environment = CATALOGUE_AIR
    throughput: Response | None = None
    blur_um: float = 0.0
    blur_px: float = 0.0
    measured: MeasuredLens | None = None

    def __post_init__(self) -> None:
        freeze_all(self, image_position_mm=(3,), image_rotation=(3, 3))
        if not self.surfaces:
            raise ConfigError(f"lens {self.name!r} has no surfaces")
        stops = sum(surface.is_stop for surface in self.surfaces)
        if stops != 1:
            raise ConfigError(f"lens {self.name!r} has {stops} stops; exactly one is needed")
        for number, (surface, before) in enumerate(zip(self.surfaces, self.media, strict=False)):
            if surface.medium != AMBIENT and surface.medium not in self.glasses:
                raise unknown_name("glass", surface.medium, self.glasses)
            if surface.mirror and surface.shape.redirects:
                raise ConfigError(f"lens {self.name!r}: {self.label(number)} ({surface.shape.kind}) cannot be a mirror")
            if surface.mirror and (surface.medium, surface.index_offset) != before:
                raise ConfigError(
                    f"lens {self.name!r}: {self.label(number)} is a mirror between {before[0]!r} and "
                    f"{surface.medium!r}; the medium behind a mirror must be the one in front of it"
                )
        if not 0 < self.max_field_deg < 90:
            raise DomainError(f"lens {self.name!r}: max_field_deg = {self.max_field_deg} deg is outside 0 ... 90 deg")

    def __repr__(self) -> str:
        return (
            f"LensSystem({self.name!r}, {len(self.surfaces)} surfaces, elements {' '.join(self.elements)}, "
            f"half field {self.max_field_deg:g} deg, {self.environment})"
        )

    @property
    def stop_index(self) -> int:
        """Index of the aperture stop in ``surfaces``."""
        return next(i for i, surface in enumerate(self.surfaces) if surface.is_stop)

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the elements, in the order light meets them."""
        return tuple(dict.fromkeys(surface.element for surface in self.surfaces if surface.element))

    @property
    def wavelength_range_nm(self) -> tuple[float, float]:
        """Range in which every glass formula and the throughput hold."""
        ranges = [self.glasses[s.medium].range_nm for s in self.surfaces if s.medium != AMBIENT]
        ranges += [] if self.throughput is None else [self.throughput.range_nm]
        return max((r[0] for r in ranges), default=200.0), min((r[1] for r in ranges), default=2500.0)

    @property
    def stop_in_front(self) -> bool:
        """Whether nothing refracts before the stop, so that the stop itself is the entrance pupil."""
        return all(
            isinstance(s.shape, Plane) and s.medium == AMBIENT and not s.mirror and s.error is None
            for s in self.surfaces[: self.stop_index + 1]
        )

    @property
    def poses(self) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """(position [mm], rotation) of every surface and, last, of the image plane, in the lens frame."""
        return (*((s.position_mm, s.rotation) for s in self.surfaces), (self.image_position_mm, self.image_rotation))

    @property
    def axis(self) -> tuple[FloatArray, ...]:
        """Unit vectors in the lens frame along which light travels before the first surface and after each one.

        The axis is turned by mirrors only, about their vertex normals.
        """
        along = [np.array([0.0, 0.0, 1.0])]
        for surface in self.surfaces:
            normal = surface.rotation[:, 2]
            along.append(along[-1] - 2.0 * (along[-1] @ normal) * normal if surface.mirror else along[-1])
        return tuple(along)

    @property
    def media(self) -> tuple[tuple[str, float], ...]:
        """(name, index offset) of what lies before the first surface and after each one."""
        return ((AMBIENT, 0.0), *((s.medium, s.index_offset) for s in self.surfaces))

    def indices(self, wavelength_nm: FloatArray | float) -> FloatArray:
        """Absolute refractive index (surfaces + 1, ...) before the first surface and after each one.

        ``wavelength_nm`` are vacuum wavelengths of any shape; DomainError outside the range of one of the glasses.
        """
        self.check_wavelength(wavelength_nm)
        wavelength = np.asarray(wavelength_nm, float)
        indices = {}
        for name, offset in dict.fromkeys(self.media):
            glass = None if name == AMBIENT else self.glasses[name]
            numbers, form, thermal = index_parameters(glass, self.environment, offset)
            indices[name, offset] = IndexFormula(at=0, form=form, thermal=thermal).index(numbers, wavelength, NUMPY)
        return np.stack([indices[medium] for medium in self.media])

    def check_wavelength(self, wavelength_nm: FloatArray | float) -> None:
        """Raise DomainError if a wavelength is outside the range of one of the glasses or of the throughput."""
        values = np.atleast_1d(np.asarray(wavelength_nm, float))
        if self.throughput is not None:
            checked_wavelength(values, self.throughput.range_nm, self.throughput.name, "the table ends there")
        for name in dict.fromkeys(s.medium for s in self.surfaces if s.medium != AMBIENT):
            what = f"glass {name} in lens {self.name!r}"
            checked_wavelength(values, self.glasses[name].range_nm, what, "its dispersion formula holds nowhere else")

    def label(self, index: int) -> str:
        """Name of a surface in messages, by the count of its file; "the image plane" behind the last."""
        if index == len(self.surfaces):
            return "the image plane"
        return self.surfaces[index].label or f"surface {index}"

    def indices_of(self, element: str) -> tuple[int, ...]:
        """Indices of the surfaces that belong to an element.

        Raises
        ------
        ConfigError
            If there is no such element.
        """
        selected = tuple(i for i, surface in enumerate(self.surfaces) if surface.element == element)
        if not selected:
            raise unknown_name("element", element, self.elements)
        return selected

    def check_surfaces(self) -> None:
        """Raise DomainError for a measured lens, which has no surfaces."""
        if self.measured is not None:
            raise DomainError(
                f"this needs a prescription: instrument.lens is a measured lens without surfaces ({self.name!r})"
            )

    def check_glass(self) -> None:
        """Raise DomainError for a lens without glass elements."""
        self.check_surfaces()
        if not self.glasses and not any(surface.mirror for surface in self.surfaces):
            raise DomainError(
                f"this needs a prescription: instrument.lens is an ideal lens without glass ({self.name!r})"
            )

    def with_surfaces(self, changed: dict[int, Surface]) -> LensSystem:
        """Copy with some surfaces replaced."""
        return replace(self, surfaces=tuple(changed.get(i, surface) for i, surface in enumerate(self.surfaces)))
