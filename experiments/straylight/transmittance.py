"""Point-source transmittance of a configured sensor by cause, of its lens and baffle and their variants."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from experiments.harness.system import prompt_pool
from experiments.laboratory.devices.scatter_laws import dust_law, surface_laws
from experiments.straylight.settings import Config
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.glass.coating import QuarterWave
from optics.lens.system import LensSystem
from optics.light.pst import PointSourceTransmittance
from optics.rays.ghosts import entrance_radius_mm
from optics.rays.stray import (
    ScatterLaw,
    ghost_light,
    imaging_rays,
    lens_scatter_light,
    scattering_surfaces,
)
from render.baffle.geometry import BlackCoating, Mesh, VanedBaffle, black_coating, vaned_baffle
from render.baffle.light import BaffleScene, lens_weight, read_mesh
from render.sensor_file.instrument import Instrument
from render.sensor_file.stray import BaffleConfig

CAUSES = ("ghosts", "polish", "dust", "walls", "edges")
DUSTIER = (100.0, 500.0, 1000.0)
"""Cleanliness levels of the first surface that the dust of a variant may have."""
SMALLEST = 1e-12
"""PST whose error does not matter."""


def direction(angle_deg: float, azimuth_deg: float) -> FloatArray:
    """Unit vector in cam."""
    a, p = np.radians([angle_deg, azimuth_deg])
    return np.array([np.sin(a) * np.cos(p), np.sin(a) * np.sin(p), np.cos(a)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensPart:
    """Light of the bare lens over z azimuths and a angles, and at p x p places of the detector."""

    value: Mapping[str, FloatArray]  # "ghosts", "polish", "dust", "dust 500" ...: (z, a)
    error: Mapping[str, FloatArray]
    places: Mapping[str, FloatArray]  # "polish", "dust": (z, a, p, p), rows and columns
    entrance_mm: float
    field_deg: float  # To the corner


def _laws(config: Config, lens: LensSystem) -> dict[str, dict[int, ScatterLaw]]:
    known = surface_laws(lens, config.scatter, config.contamination)
    laws: dict[str, dict[int, ScatterLaw]] = {
        name: {number: law.bsdf for number, law in own.items()} for name, own in known.items()
    }
    first = scattering_surfaces(lens)[0]
    for level in DUSTIER if config.what_if else ():
        laws[f"dust {level:g}"] = laws["dust"] | {first: dust_law(lens, level, config.contamination).bsdf}
    return laws


def lens_part(config: Config, instrument: Instrument, advance: Callable[[], None]) -> LensPart:
    """Ghosts and scatter of the lens for all directions of the source."""
    camera, setting = instrument.camera, config.pst
    lens = camera.focused_lens
    coating = QuarterWave(design_wavelength_nm=config.instrument.coating_nm) if config.instrument.coating_nm else None
    common: dict[str, Any] = {"coating": coating, "absorption": config.instrument.absorption}
    half = 0.5 * np.array([camera.width_px, camera.height_px]) * camera.pixel_pitch_mm
    across = (np.arange(setting.points) + 0.5) / setting.points * 2.0 - 1.0
    x, y = np.meshgrid(across * camera.width_px / 2.0, across * camera.height_px / 2.0)
    x0, y0 = camera.centre_px
    places = camera.nominal_direction(x.ravel() + x0, y.ravel() + y0, instrument.focal_length_mm)
    imaging = imaging_rays(lens, places, rings=setting.rings, arms=setting.arms, **common)
    laws = _laws(config, lens)
    shape = (len(setting.azimuths_deg), len(setting.angles_deg))
    found = {name: np.zeros((*shape, setting.points, setting.points)) for name in laws}
    ghosts, ghosts_error = np.zeros(shape), np.zeros(shape)

    entrance, field_deg = entrance_radius_mm(lens), corner_deg(instrument)
    fitted = baffle_of(config.baffle, entrance, field_deg)  # a mesh may be lit from anywhere
    round_from = fitted.shade_deg if isinstance(fitted, VanedBaffle) else 90.0

    def one(at: tuple[int, int]) -> None:
        angle = setting.angles_deg[at[1]]
        # in the shade only the mean over azimuths counts, which weighs the light of the baffle
        if angle < 90.0 and (at[0] == 0 or angle < round_from):
            source = direction(angle, setting.azimuths_deg[at[0]])
            light = lens_scatter_light(imaging, source, laws)
            for name in laws:
                found[name][at] = light[name].sum(axis=1).reshape(setting.points, setting.points)
            ghost = ghost_light(
                lens, source, tuple(half.tolist()), rings=setting.ghost_rings, arms=setting.ghost_arms,
                detector_reflectance=config.scatter.detector_reflectance, **common,
            )  # fmt: skip
            value, error = np.array(list(ghost.values())).T
            ghosts[at], ghosts_error[at] = value.sum(), np.sqrt((error**2).sum())
        advance()

    with prompt_pool() as pool:
        list(pool.map(one, np.ndindex(shape)))
    dark = np.array(setting.angles_deg) >= round_from
    for light in (ghosts, ghosts_error, *found.values()):
        light[1:, dark] = light[:1, dark]
    value = {"ghosts": ghosts} | {name: light.mean(axis=(2, 3)) for name, light in found.items()}
    return LensPart(
        value=value,
        error={"ghosts": ghosts_error} | {name: 0.0 * light for name, light in value.items() if name != "ghosts"},
        places={name: found[name] for name in ("polish", "dust")},
        entrance_mm=entrance,
        field_deg=field_deg,
    )


def corner_deg(instrument: Instrument) -> float:
    """Half angle of the field to the corner of the detector."""
    half = 0.5 * np.array([instrument.camera.width_px, instrument.camera.height_px])
    x, y = instrument.camera.centre_px + half
    return float(np.degrees(np.arccos(instrument.camera.nominal_direction(x, y, instrument.focal_length_mm)[2])))


def check_baffle(config: Config, instrument: Instrument) -> None:
    """Early checks: refuse a lens without surfaces, an open mesh, vanes that cut the beam of the field."""
    lens = instrument.camera.focused_lens
    lens.check_surfaces()
    if not scattering_surfaces(lens):
        raise DomainError(
            f"lens {lens.name!r} has no surfaces that reflect or scatter; take a lens file, or a table: pst.file"
        )
    entrance, field_deg = entrance_radius_mm(lens), corner_deg(instrument)
    parts = baffle_of(config.baffle, entrance, field_deg)
    if parts is not None:
        _scene(config, config.baffle, parts, entrance, field_deg)


def _scene(
    config: Config, baffle: BaffleConfig, parts: VanedBaffle | Mesh, entrance_mm: float, field_deg: float
) -> BaffleScene:
    try:
        return BaffleScene(parts, coating_of(baffle), entrance_mm=entrance_mm, field_deg=field_deg, seed=config.seed)
    except DomainError as fault:
        raise DomainError(f"baffle: {fault}") from None


def coating_of(config: BaffleConfig) -> BlackCoating:
    """The black coating of a baffle."""
    if config.coating != "own":
        return black_coating(config.coating)
    return BlackCoating(
        name="own", diffuse=config.diffuse, specular=config.specular, roughness=config.roughness, source="settings"
    )


def baffle_of(config: BaffleConfig, entrance_mm: float, field_deg: float) -> VanedBaffle | Mesh | None:
    """The baffle of a configuration; None for a bare lens."""
    if not config.fitted:
        return None
    if config.mesh:
        return read_mesh(config.mesh)
    try:
        return vaned_baffle(
            entrance_mm=entrance_mm,
            field_deg=field_deg,
            shade_deg=config.shade_deg if config.length_mm is None else None,
            length_mm=config.length_mm,
            depth_mm=config.vane_depth_mm,
            vanes=config.vanes,
            clearance_mm=config.clearance_mm,
            edge_mm=1e-3 * config.edge_radius_um,
        )
    except DomainError as error:
        raise DomainError(f"baffle: {error}") from None


@dataclass(frozen=True, kw_only=True, eq=False)
class Stray:
    """Stray light of lens and baffle."""

    pst: PointSourceTransmittance
    direct: FloatArray  # (z, a) Part of the entrance that the source shines on
    lens: LensPart | None = None
    scene: BaffleScene | None = None
    rays: int = 0
    weight: Any = field(default=None)  # PST of the bare lens against the angle [rad]

    @cached_property
    def baffle(self) -> VanedBaffle | Mesh | None:
        """The baffle in the scene."""
        return None if self.scene is None else (self.scene.baffle or self.scene.mesh)


def transmittance(
    config: Config,
    lens: LensPart,
    baffle: BaffleConfig,
    *,
    dust: str = "dust",
    angles: Sequence[int] | None = None,
    advance: Callable[[], None] = lambda: None,
) -> Stray:
    """All causes together: light passed by the baffle and scattered by it into the lens.

    ``dust`` names the dust of the lens; ``angles`` are the numbers of the wanted angles, all if left out.
    """
    setting = config.pst
    chosen = np.arange(len(setting.angles_deg)) if angles is None else np.asarray(angles)
    bare = {name: lens.value[key] for name, key in (("ghosts", "ghosts"), ("polish", "polish"), ("dust", dust))}
    total = np.asarray(sum(bare.values())).mean(axis=0)
    known = total > 0.0
    parts = baffle_of(baffle, lens.entrance_mm, lens.field_deg)
    shape = (len(CAUSES), len(setting.azimuths_deg), len(chosen))
    value, error, direct = np.zeros(shape), np.zeros(shape), np.ones(shape[1:])
    scene, rays, weight = None, 0, None
    if parts is not None:
        scene = _scene(config, baffle, parts, lens.entrance_mm, lens.field_deg)
        weight = lens_weight(np.array(setting.angles_deg)[known], total[known])
        round_ = isinstance(parts, VanedBaffle)
        for z, azimuth in enumerate(setting.azimuths_deg):
            for a, at in enumerate(chosen):
                if round_ and z:  # the same from all sides
                    value[3:, z, a], error[3:, z, a], direct[z, a] = value[3:, 0, a], error[3:, 0, a], direct[0, a]
                    advance()
                    continue
                source = direction(setting.angles_deg[at], azimuth)
                light = scene.light(
                    source, weight, error=setting.walls_error, number=1000 * z + int(at), least=SMALLEST
                )
                direct[z, a] = light.direct
                value[3:, z, a], error[3:, z, a] = (light.walls, light.edges), (light.walls_error, light.edges_error)
                rays += light.rays
                advance()
    for row, (name, light_) in enumerate(bare.items()):
        value[row] = light_[:, chosen] * direct
        error[row] = lens.error[dust if name == "dust" else name][:, chosen] * direct
    pst = PointSourceTransmittance(
        angle_deg=np.array(setting.angles_deg)[chosen],
        azimuth_deg=np.array(setting.azimuths_deg),
        causes=CAUSES,
        value=value,
        error=error,
        source=f"starbench straylight, {config.name or 'as configured'}",
    )
    return Stray(pst=pst, direct=direct, lens=lens, scene=scene, rays=rays, weight=weight)
