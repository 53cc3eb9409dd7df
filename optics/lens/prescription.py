"""Lens prescriptions in TOML files, with the meaning and source of every number.

Signs follow design programs: the z axis keeps its direction at mirrors, so that thicknesses are negative behind an odd
number of mirrors; a radius is positive if the centre of curvature lies towards +z. `optics.lens.system` contains the
same lens with every surface in a frame in which light travels along +z.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError, StarbenchError, unknown_name
from optics.glass.absolute_index import CATALOGUE_AIR, Environment
from optics.glass.catalogue import Glass, get_glass, glass_from_table
from optics.lens.geometry import axial_ray
from optics.lens.sag_map import SagMap, read_map
from optics.lens.shapes.plane import Plane
from optics.lens.system import AMBIENT, STOP_ALONE, LensSystem, Surface
from optics.lens.tables import MIRROR, BreakTable, ErrorTable, MovedTable, Prescription, PupilTable, SurfaceTable
from optics.validate import parse_model

EDGE_ON = 1e-6
"""Cosine of the axis with a surface's normal below which the surface is edge-on to the light."""
UNIT_MM = {"nm": 1e-6, "um": 1e-3, "mm": 1.0}


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """Origin [mm] and axes (columns) in the lens frame."""

    origin: FloatArray = field(default_factory=lambda: np.zeros(3))
    axes: FloatArray = field(default_factory=lambda: np.eye(3))

    def moved(self, by: MovedTable) -> LocalFrame:
        """The frame after a shift and a turn."""
        shift = np.array([*by.decentre_mm, 0.0][:3])
        angles = [*by.tilt_deg, 0.0][:3]
        turn = np.eye(3)
        if any(angles):
            order = "xyz" if by.axes == "fixed" else "XYZ"
            turn = Rotation.from_euler(order, angles, degrees=True).as_matrix()
        axes = self.axes @ turn
        return LocalFrame(self.origin + (self.axes if by.first == "decentre" else axes) @ shift, axes)

    def bent(self, normal: FloatArray) -> LocalFrame:
        """The frame behind a mirror: turned twice by the smallest turn that takes its z axis to the mirror's normal."""
        z = self.axes[:, 2]
        along = np.cross(z, normal)
        sine = float(np.linalg.norm(along))
        if sine == 0.0:
            return self
        twice = 2.0 * np.arctan2(sine, float(z @ normal))
        return LocalFrame(self.origin, Rotation.from_rotvec(along / sine * twice).as_matrix() @ self.axes)

    def after(self, thickness_mm: float) -> LocalFrame:
        """The frame a thickness further along its z axis."""
        return LocalFrame(self.origin + thickness_mm * self.axes[:, 2], self.axes)


def _error_map(table: ErrorTable | None, folder: Path) -> SagMap | None:
    """Map of a measured surface error."""
    if table is None:
        return None
    values = read_map(folder / table.file)
    return SagMap(values_mm=values * (table.scale * UNIT_MM[table.unit]), width_mm=table.width_mm)


def _surface(table: SurfaceTable, frame: LocalFrame, before: str, folder: Path, label: str) -> Surface:
    """The surface that a table describes, in a frame where light travels towards +z."""
    mirror = table.medium == MIRROR
    return Surface(
        shape=table.shape(),
        position_mm=frame.origin,
        rotation=frame.axes,
        medium=before if mirror else table.medium,
        mirror=mirror,
        semi_diameter_mm=table.semi_diameter_mm,
        inner_semi_diameter_mm=table.inner_semi_diameter_mm,
        apertures=tuple(aperture.aperture() for aperture in table.aperture),
        error=_error_map(table.error, folder),
        cte_per_k=table.cte_per_k,
        element=table.element,
        is_stop=table.stop,
        label=label,
    )


def _placed(file: Prescription, folder: Path, labels: Sequence[str]) -> tuple[list[Surface], LocalFrame]:
    """Surfaces at their vertices, and the frame of the image plane."""
    frame, light, medium = LocalFrame(), np.array([0.0, 0.0, 1.0]), AMBIENT
    surfaces: list[Surface] = []
    for label, table in zip(labels, file.surface, strict=True):
        if isinstance(table, BreakTable):
            frame = frame.moved(table).after(table.thickness_mm)
            continue
        pose = frame.moved(table)
        if table.carry != "none":
            frame = pose if table.carry == "forward" else LocalFrame(pose.origin, frame.axes).bent(pose.axes[:, 2])
        normal = pose.axes[:, 2]
        facing = float(light @ normal)
        if abs(facing) < EDGE_ON:
            raise ConfigError(f"{label} is edge-on to the light on the axis; check tilts and breaks before it")
        try:
            surface = _surface(table, pose, medium, folder, label)
        except StarbenchError as error:
            raise type(error)(f"{label}: {error}") from None
        surfaces.append(surface if facing > 0.0 else surface.from_behind())
        if surface.mirror:
            light = light - 2.0 * facing * normal
        medium = surface.medium
        along = table.thickness_mm * float(np.sign(light @ frame.axes[:, 2]))
        if medium != AMBIENT and along < 0.0:
            raise ConfigError(
                f"{label}: thickness_mm = {table.thickness_mm:g} mm of {medium} has the wrong sign; thicknesses are "
                "negative behind an odd number of mirrors, otherwise positive"
            )
        frame = frame.after(table.thickness_mm)
    frame = frame.moved(file.image)
    facing = float(light @ frame.axes[:, 2])
    if abs(facing) < EDGE_ON:
        raise ConfigError("the image plane is edge-on to the light on the axis; check tilts and breaks")
    return surfaces, frame if facing > 0.0 else LocalFrame(frame.origin, frame.axes @ np.diag([1.0, 1.0, -1.0]))


def _with_stop(file: Prescription, surfaces: list[Surface]) -> list[Surface]:
    """The surfaces with the stop that is not one of the file's list."""
    if file.stop is None:
        return surfaces
    z = file.stop.z_mm
    index = next((i for i, s in enumerate(surfaces) if s.position_mm[2] >= z), len(surfaces))
    if any(s.mirror or not np.array_equal(s.rotation, np.eye(3)) for s in surfaces[:index]):
        raise ConfigError(
            f"stop.z_mm = {z:g} mm stands behind a tilted surface or a mirror; give the stop as a surface with "
            "stop = true"
        )
    stop = Surface(
        shape=Plane(),
        position_mm=np.array([0.0, 0.0, z]),
        medium=surfaces[index - 1].medium if index else AMBIENT,
        semi_diameter_mm=file.stop.semi_diameter_mm,
        inner_semi_diameter_mm=file.stop.inner_semi_diameter_mm,
        is_stop=True,
        label=STOP_ALONE,
    )
    return [*surfaces[:index], stop, *surfaces[index:]]


def _glasses(file: Prescription, media: list[str], where: str) -> dict[str, Glass]:
    """Records of the glasses that the surfaces name; those defined in the file come before the catalogue's."""
    glasses = {}
    for name in dict.fromkeys(medium for medium in media if medium != AMBIENT):
        table = file.glass.get(name)
        try:
            glasses[name] = (
                get_glass(name) if table is None else glass_from_table(name, table.model_dump(exclude_none=True))
            )
        except StarbenchError as error:
            raise ConfigError(f"{where}: {error}") from None
    return glasses


def _coated(file: Prescription, lens: LensSystem, names: Mapping[str, str]) -> LensSystem:
    """The lens with its coatings; ``names`` by label of the surface."""

    def glass_of(name: str) -> Glass:
        return _glasses(file, [name], "film")[name]

    coatings = file.coatings(glass_of)
    for name in (file.default_coating, *names.values()):
        if name and name not in coatings:
            raise unknown_name("coating", name, coatings)
    changed = {}
    for number, (surface, (before, _)) in enumerate(zip(lens.surfaces, lens.media, strict=False)):
        air_glass = (before == AMBIENT) != (surface.medium == AMBIENT)
        name = names.get(surface.label, "") or (file.default_coating if air_glass else "")
        if name and (surface.mirror or (before, surface.medium) != (AMBIENT, AMBIENT)):
            try:
                changed[number] = replace(surface, coating=coatings[name])
            except ConfigError as error:
                raise ConfigError(f"{surface.label}: {error}") from None
    return lens.with_surfaces(changed)


def glasses_of(file: Prescription) -> dict[str, Glass]:
    """Glasses that the surfaces of a prescription name; ConfigError for one that is not known."""
    media = [table.medium for table in file.surface if isinstance(table, SurfaceTable) and table.medium != MIRROR]
    return _glasses(file, media, file.name)


def _parsed(mapping: Mapping[str, Any], where: str, labels: Sequence[str] | None) -> Prescription:
    """A prescription's tables; errors name a surface by its label."""
    try:
        return parse_model(Prescription, mapping, where)
    except ConfigError as error:
        if labels is None:
            raise
        named = re.sub(r"\bsurface\.(\d+)\.", lambda match: f"{labels[int(match[1])]}: ", str(error))
        raise ConfigError(named) from None


def rims_mm(mapping: Mapping[str, Any], where: str, labels: Sequence[str]) -> list[float]:
    """Radius at which each surface ends, infinite where it does not; coordinate breaks too; as `lens_from_table`."""
    file = _parsed(mapping, where, labels)
    return [math.inf if isinstance(table, BreakTable) else table.shape().rim_mm for table in file.surface]


def _check_apertures(file: Prescription, where: str, labels: Sequence[str]) -> None:
    """Refuse a clear aperture that reaches beyond the rim where a surface ends, or beyond its measured part."""
    for label, table in zip(labels, file.surface, strict=True):
        if isinstance(table, BreakTable) or np.isinf(table.semi_diameter_mm):
            continue
        if table.error is not None and 2.0 * table.semi_diameter_mm > min(table.error.width_mm):
            raise ConfigError(
                f"{where}: {label}: semi_diameter_mm = {table.semi_diameter_mm:g} mm reaches beyond its "
                f"measured error, {min(table.error.width_mm):g} mm wide"
            )
        shape = table.shape()
        if table.semi_diameter_mm >= shape.rim_mm:
            raise ConfigError(
                f"{where}: {label}: semi_diameter_mm = {table.semi_diameter_mm:g} mm reaches the rim of the "
                f"surface ({shape}); it must be below {shape.rim_mm:.6g} mm"
            )


def lens_from_table(
    mapping: Mapping[str, Any],
    *,
    where: str,
    folder: str | Path = ".",
    environment: Environment = CATALOGUE_AIR,
    labels: Sequence[str] | None = None,
) -> LensSystem:
    """Make a lens from the tables of a prescription, from any file format."""
    file = _parsed(mapping, where, labels)
    names = [f"surface {number}" for number in range(len(file.surface))] if labels is None else labels
    try:
        placed, image = _placed(file, Path(folder), names)
        surfaces = _with_stop(file, placed)
    except StarbenchError as error:
        raise ConfigError(f"{where}: {error}") from None
    glasses = _glasses(file, [s.medium for s in surfaces], where)
    if surfaces[-1].medium != AMBIENT:
        raise ConfigError(f"{where}: {names[-1]}, the last, is followed by {surfaces[-1].medium!r}; it must be 'air'")
    _check_apertures(file, where, names)
    lens = LensSystem(
        name=file.name,
        source=file.source,
        surfaces=tuple(surfaces),
        glasses=glasses,
        image_position_mm=image.origin,
        image_rotation=image.axes,
        design_wavelength_nm=file.design_wavelength_nm,
        max_field_deg=file.max_field_deg,
        environment=environment,
    )
    coating = {label: s.coating for label, s in zip(names, file.surface, strict=True) if isinstance(s, SurfaceTable)}
    try:
        lens = _coated(file, lens, coating)
    except StarbenchError as error:
        raise ConfigError(f"{where}: {error}") from None
    return lens if file.pupil is None else _opened(lens, file.pupil, where)


def _opened(lens: LensSystem, pupil: PupilTable, where: str) -> LensSystem:
    """The lens with its stop opened to an F-number or an entrance pupil."""
    height, focal_mm = axial_ray(lens)
    diameter = pupil.entrance_pupil_diameter_mm
    if pupil.f_number is not None:
        diameter = abs(focal_mm) / pupil.f_number
    radius = 0.5 * float(diameter or np.inf) * abs(float(height[lens.stop_index]))
    stop = lens.surfaces[lens.stop_index]
    if not stop.inner_semi_diameter_mm < radius < stop.shape.rim_mm:
        raise ConfigError(
            f"{where}: [pupil] requires a stop of radius {radius:.6g} mm; it must lie between its hole, "
            f"{stop.inner_semi_diameter_mm:g} mm, and the rim of its surface, {stop.shape.rim_mm:.6g} mm"
        )
    return lens.with_surfaces({lens.stop_index: replace(stop, semi_diameter_mm=radius)})
