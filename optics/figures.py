"""Lens drawings with ray fans, spot diagrams, distortion plots and star images.

Every function returns a `matplotlib.figure.Figure`, which ``figure.savefig("lens.png")`` writes, or the axes it drew
into; pyplot and its global state are not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy.ndimage import grey_dilation

from optics.arrays import NUMPY, FloatArray
from optics.frames import field_direction, light_direction
from optics.lens.apertures import Spider
from optics.lens.system import AMBIENT, LensSystem
from optics.rays.distortion import distortion_map
from optics.rays.entrance_pupil import entrance_pupil
from optics.rays.pupil_sampling import gauss_disk
from optics.rays.spots import trace_spots
from optics.rays.trace import Rays, trace_path

FIELD_COLOURS = ("#1f5fa8", "#2a8c4a", "#c0392b", "#8e44ad", "#d68910", "#117a8b")
GLASS_EDGE, GLASS_TINTS = "#34495e", ("#cfe3f5", "#d9ecd2", "#fbe3c6", "#e6d9f0", "#f6d5d5")
PROFILE_POINTS = 81


def wavelength_colour(wavelength_nm: float) -> str:
    """Colour by which a wavelength is drawn: the spectrum's order, readable on white (not colorimetry)."""
    stops_nm = np.array([400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 750.0, 900.0])
    rgb = np.array(
        [
            [0.42, 0.16, 0.60], [0.15, 0.25, 0.80], [0.05, 0.55, 0.65], [0.13, 0.60, 0.20],
            [0.90, 0.55, 0.05], [0.82, 0.15, 0.12], [0.55, 0.05, 0.10], [0.30, 0.02, 0.08],
        ]
    )  # fmt: skip
    channels = [int(np.rint(255 * np.interp(wavelength_nm, stops_nm, rgb[:, i]))) for i in range(3)]
    return "#{:02x}{:02x}{:02x}".format(*channels)


def _profile(lens: LensSystem, index: int, half_height_mm: float) -> FloatArray:
    """Section of a surface with the plane x = 0, lens frame, (points, 2) as (z, y)."""
    surface = lens.surfaces[index]
    y = np.linspace(-half_height_mm, half_height_mm, PROFILE_POINTS)
    x = np.zeros_like(y)
    local = np.stack([x, y, surface.shape.sag(x, y)], axis=-1)
    points = local @ surface.rotation.T + surface.position_mm
    return points[:, [2, 1]]


def _glass_runs(lens: LensSystem) -> list[tuple[int, int, str]]:
    """(front surface, back surface, glass) of every piece of glass."""
    return [(i, i + 1, surface.medium) for i, surface in enumerate(lens.surfaces) if surface.medium != AMBIENT]


def _reaches(lens: LensSystem, fans: Sequence[FloatArray]) -> list[float]:
    """Half height to which each surface is drawn: its clear aperture, or what the rays need if that is unlimited."""
    heights = []
    for i, surface in enumerate(lens.surfaces):
        if np.isfinite(surface.semi_diameter_mm):
            heights.append(surface.semi_diameter_mm)
            continue
        reached = [
            np.linalg.norm(((fan[i + 1] - surface.position_mm) @ surface.rotation)[..., :2], axis=-1) for fan in fans
        ]
        heights.append(1.05 * float(np.nanmax(np.concatenate([np.ravel(r) for r in reached]))))
    return heights


def _draw_glass(axes: Axes, lens: LensSystem, reach: Sequence[float]) -> None:
    tints = {glass: GLASS_TINTS[i % len(GLASS_TINTS)] for i, glass in enumerate(lens.glasses)}
    for front, back, glass in _glass_runs(lens):
        # the rim: both faces end at the larger aperture; the smaller one continues as a flat ground edge
        rim = max(reach[front], reach[back])
        outline = []
        for index in (front, back):
            face = _profile(lens, index, reach[index])
            ends = face[[0, -1]] + np.array([[0.0, reach[index] - rim], [0.0, rim - reach[index]]])
            outline.append(np.vstack([ends[:1], face, ends[1:]]))
        polygon = np.vstack([outline[0], outline[1][::-1]])
        axes.fill(polygon[:, 0], polygon[:, 1], facecolor=tints[glass], edgecolor=GLASS_EDGE, linewidth=0.9, zorder=2)
    for glass in dict.fromkeys(glass for _, _, glass in _glass_runs(lens)):
        axes.fill([], [], facecolor=tints[glass], edgecolor=GLASS_EDGE, linewidth=0.9, label=glass)


def _without_vanes(lens: LensSystem) -> LensSystem:
    """The lens without vanes, on which the section itself often lies."""
    changed = {}
    for i, surface in enumerate(lens.surfaces):
        outlines = tuple(aperture for aperture in surface.apertures if not isinstance(aperture, Spider))
        changed[i] = replace(surface, apertures=outlines)
    return lens.with_surfaces(changed)


def _mirror_face(lens: LensSystem, index: int, half_height_mm: float) -> FloatArray:
    """`_profile` of a mirror, NaN where its hole or its outlines leave nothing of it."""
    surface, face = lens.surfaces[index], _profile(lens, index, half_height_mm)
    y = np.linspace(-half_height_mm, half_height_mm, PROFILE_POINTS)
    reflects = np.abs(y) >= surface.inner_semi_diameter_mm
    for outline in surface.apertures:
        reflects &= outline.inside(outline.parameters(), np.zeros_like(y), y, NUMPY) != outline.obscures
    return np.where(reflects[:, None], face, np.nan)


def _draw_mirrors(axes: Axes, lens: LensSystem, reach: Sequence[float]) -> None:
    for index, surface in enumerate(lens.surfaces):
        if surface.mirror:
            face = _mirror_face(lens, index, reach[index])
            axes.plot(face[:, 0], face[:, 1], color=GLASS_EDGE, linewidth=2.0, zorder=4)


def _draw_stop(axes: Axes, lens: LensSystem, height: float) -> None:
    stop = lens.surfaces[lens.stop_index]
    for sign in (1.0, -1.0):
        local = np.array([[0.0, sign * stop.semi_diameter_mm, 0.0], [0.0, sign * height, 0.0]])
        points = local @ stop.rotation.T + stop.position_mm
        axes.plot(points[:, 2], points[:, 1], color="black", linewidth=2.2, solid_capstyle="butt", zorder=4)


def _fan(lens: LensSystem, field_y_deg: float, rays: int, wavelength_nm: float, lead_mm: float) -> FloatArray:
    """Points of a meridional fan, evenly spread over the part of the pupil that passes; (surfaces + 2, rays, 3)."""
    pupil = entrance_pupil(lens, wavelength_nm=[wavelength_nm])
    direction = light_direction(field_direction(0.0, field_y_deg))

    def paths(y: FloatArray) -> FloatArray:
        start = np.stack([np.full_like(y, pupil.x_mm), pupil.y_mm + y, np.full_like(y, pupil.z_mm)], axis=-1)
        start = start + direction * ((-lead_mm - start[:, 2]) / direction[2])[:, None]
        launched = Rays.create(
            x_mm=start[:, 0], y_mm=start[:, 1], z_mm=start[:, 2], direction=direction, wavelength_nm=wavelength_nm
        )
        return trace_path(lens, launched)

    search = np.linspace(-1.0, 1.0, 401) * pupil.radius_mm
    passes = search[np.isfinite(paths(search)[-1, :, 0])]
    if not passes.size:
        return np.full((len(lens.surfaces) + 2, 0, 3), np.nan)
    return paths(np.linspace(passes[0], passes[-1], rays))


def _extent(drawn: Sequence[FloatArray], fans: Sequence[FloatArray], length: float) -> tuple[FloatArray, FloatArray]:
    """Lower and upper limits (z, y) of all that is drawn; of the light in front of the lens only its last part."""
    rays = np.concatenate([fan[..., [2, 1]].reshape(-1, 2) for fan in fans])
    points = np.concatenate([*drawn, rays])
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    margin = np.array([0.04 * length, 0.08 * max(float(high[1] - low[1]), 0.1 * length)])
    return low - margin - [0.0, margin[1]], high + margin  # names of elements stand at the bottom


def draw_lens(
    lens: LensSystem,
    *,
    fields_deg: Sequence[float] | None = None,
    rays: int = 7,
    wavelength_nm: float | None = None,
) -> Figure:
    """Section through the lens (plane x = 0) with a fan of rays per field.

    Parameters
    ----------
    lens : LensSystem
        The lens; may be perturbed.
    fields_deg : sequence of float, optional
        Field angles along y [deg]; 0, 0.7 and 1 of the lens's field if left out.
    rays : int
        Rays per fan.
    wavelength_nm : float, optional
        Wavelength; the design wavelength if left out.

    Returns
    -------
    matplotlib.figure.Figure
        Made without pyplot; ``figure.savefig("lens.png")`` keeps it.
    """
    wave = lens.design_wavelength_nm if wavelength_nm is None else wavelength_nm
    fields = [0.0, 0.7 * lens.max_field_deg, lens.max_field_deg] if fields_deg is None else list(fields_deg)
    along_z = [float(position[2]) for position, _ in lens.poses]
    length = max(along_z) - min(along_z)
    lens = _without_vanes(lens)
    fans = [_fan(lens, field, rays, wave, 0.12 * length - min(along_z)) for field in fields]
    reach = _reaches(lens, fans)
    landed = np.concatenate([(fan[-1] - lens.image_position_mm) @ lens.image_rotation for fan in fans])
    image = 1.15 * float(np.nanmax(np.abs(landed[:, 1]), initial=0.0))
    ends = np.array([[0.0, -image, 0.0], [0.0, image, 0.0]]) @ lens.image_rotation.T + lens.image_position_mm
    solid = {i for run in _glass_runs(lens) for i in run[:2]}
    faces = [_profile(lens, i, reach[i]) for i in sorted(solid)]
    faces += [_mirror_face(lens, i, reach[i]) for i, s in enumerate(lens.surfaces) if s.mirror]
    low, high = _extent([ends[:, [2, 1]], *faces], fans, length)
    figure = Figure(
        figsize=(10.0, float(np.clip(8.0 * (high[1] - low[1]) / (high[0] - low[0]) + 0.9, 3.0, 7.0))),
        layout="constrained",
    )
    axes = figure.add_subplot()
    axes.axhline(0.0, color="0.55", linewidth=0.6, dashes=(12, 3, 2, 3), zorder=1)
    for number, (field, fan) in enumerate(zip(fields, fans, strict=True)):
        lines = [fan[:, ray][:, [2, 1]] for ray in range(fan.shape[1])]
        colour = FIELD_COLOURS[number % len(FIELD_COLOURS)]
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=0.7, zorder=3))
        axes.plot([], [], color=colour, linewidth=1.2, label=f"{field:.3g}°")
    _draw_glass(axes, lens, reach)
    _draw_mirrors(axes, lens, reach)
    stop_mm = lens.surfaces[lens.stop_index].semi_diameter_mm
    folded = any(s.mirror for s in lens.surfaces)  # other mirrors may be wide and far away
    _draw_stop(axes, lens, 1.3 * stop_mm if folded else 1.12 * max(*reach, stop_mm))
    axes.plot(ends[:, 2], ends[:, 1], color="black", linewidth=1.4, zorder=4)
    for name in lens.elements:
        middle = np.mean([lens.surfaces[i].position_mm[2] for i in lens.indices_of(name)])
        axes.annotate(name, (middle, low[1]), ha="center", va="bottom", fontsize=9, color="0.25")
    axes.set(xlabel="z [mm]", ylabel="y [mm]", title=f"{lens.name}, {wave:g} nm")
    axes.set_aspect("equal")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
    return figure


def draw_spots(
    lens: LensSystem,
    *,
    fields_deg: Sequence[tuple[float, float]] | None = None,
    wavelength_nm: Sequence[float] | None = None,
    pixel_um: float | None = None,
) -> Figure:
    """Spot diagrams about the mean of all wavelengths, one panel per field, all at one scale.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    fields_deg : sequence of (x, y), optional
        Field angles [deg]; 0, 0.5, 0.7 and 1 of the lens's field along y if left out.
    wavelength_nm : sequence of float, optional
        Wavelengths; 0.8, 1 and 1.25 times the design wavelength if left out.
    pixel_um : float, optional
        Draws a pixel of this pitch.

    Returns
    -------
    matplotlib.figure.Figure
        Made without pyplot; ``figure.savefig("lens.png")`` keeps it.
    """
    fields = (
        [(0.0, fraction * lens.max_field_deg) for fraction in (0.0, 0.5, 0.7, 1.0)]
        if fields_deg is None
        else list(fields_deg)
    )
    waves = (
        [factor * lens.design_wavelength_nm for factor in (0.8, 1.0, 1.25)] if wavelength_nm is None else wavelength_nm
    )
    field_x, field_y = np.array(fields, float).T
    spots = trace_spots(lens, field_x, field_y, waves, samples=gauss_disk(10, 36))  # rings that look even
    weight = spots.area_mm2 / np.maximum(spots.area_mm2.sum(axis=(1, 2), keepdims=True), 1e-300)
    offsets = []
    for position in (spots.rays.x, spots.rays.y):
        height = np.where(spots.area_mm2 > 0, position, 0.0)
        offsets.append(1e3 * (height - (weight * height).sum(axis=(1, 2), keepdims=True)))
    x, y = (np.where(spots.area_mm2 > 0, offset, np.nan) for offset in offsets)
    half = 1.12 * float(np.nanmax(np.hypot(x, y)))
    figure = Figure(figsize=(2.9 * len(fields), 3.6), layout="constrained")
    panels = figure.subplots(1, len(fields), squeeze=False)[0]
    for number, (axes, (fx, fy)) in enumerate(zip(panels, fields, strict=True)):
        for band, wave in enumerate(waves):
            axes.plot(
                x[number, band],
                y[number, band],
                ".",
                color=wavelength_colour(wave),
                markersize=2.0,
                label=f"{wave:.0f} nm",
            )
        if pixel_um is not None:
            side = pixel_um / 2.0
            axes.plot([-side, side, side, -side, -side], [-side, -side, side, side, -side], color="0.4", linewidth=0.9)
        square = np.nansum(weight[number] * (x[number] ** 2 + y[number] ** 2))
        axes.set_title(f"({fx:.3g}°, {fy:.3g}°)   rms {np.sqrt(square):.2f} µm", fontsize=9)
        axes.axhline(0.0, color="0.8", linewidth=0.5, zorder=0)
        axes.axvline(0.0, color="0.8", linewidth=0.5, zorder=0)
        axes.set(xlim=(-half, half), ylim=(-half, half), xlabel="x [µm]")
        axes.set_aspect("equal")
        axes.tick_params(labelsize=8)
    panels[0].set_ylabel("y [µm]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=len(waves), frameon=False, fontsize=9, markerscale=4
    )
    what = "" if pixel_um is None else f" (square: a {pixel_um:g} µm pixel)"
    figure.suptitle(f"{lens.name}: spots about the mean of all wavelengths{what}", fontsize=10)
    return figure


def draw_distortion(
    lens: LensSystem, *, count: int = 11, wavelength_nm: float | None = None, exaggeration: float | None = None
) -> Figure:
    """Distortion: the ideal f tan(field) grid with the exaggerated real one, and radial distortion over the field.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    count : int
        Grid points per side.
    wavelength_nm : float, optional
        Wavelength; the design wavelength if left out.
    exaggeration : float, optional
        Factor on the displacements; if left out, a round one that makes them visible.

    Returns
    -------
    Figure
        Of matplotlib.
    """
    grid = distortion_map(lens, count=count, wavelength_nm=wavelength_nm)
    dx, dy = grid.x_mm - grid.ideal_x_mm, grid.y_mm - grid.ideal_y_mm
    largest = float(np.hypot(dx, dy).max())
    cell = float(grid.ideal_x_mm[0, 1] - grid.ideal_x_mm[0, 0])
    factor = exaggeration
    if factor is None:
        wanted = 0.6 * abs(cell) / max(largest, 1e-12)
        factor = max(1.0, float(f"{wanted:.0e}")) if wanted < 1e9 else 1.0
    figure = Figure(figsize=(9.6, 4.7), layout="constrained")
    grid_axes, radial_axes = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    for x, y, style in (
        (grid.ideal_x_mm, grid.ideal_y_mm, {"color": "0.7", "linewidth": 0.8}),
        (grid.ideal_x_mm + factor * dx, grid.ideal_y_mm + factor * dy, {"color": FIELD_COLOURS[0], "linewidth": 1.1}),
    ):
        grid_axes.plot(x, y, **style)
        grid_axes.plot(x.T, y.T, **style)
    grid_axes.plot([], [], color="0.7", label=f"ideal, f = {grid.focal_length_mm:.3f} mm")
    grid_axes.plot([], [], color=FIELD_COLOURS[0], label=f"real, displacements x {factor:g}")
    grid_axes.set_aspect("equal")
    grid_axes.set(xlabel="x [mm]", ylabel="y [mm]")
    grid_axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False, fontsize=9, ncols=2)
    tangent = np.hypot(np.tan(np.radians(grid.field_x_deg)), np.tan(np.radians(grid.field_y_deg))).ravel()
    order = np.argsort(tangent)
    field, relative = np.degrees(np.arctan(tangent[order])), 100.0 * grid.relative.ravel()[order]
    radial_axes.plot(relative, field, ".", color=FIELD_COLOURS[0], markersize=4)
    radial_axes.axvline(0.0, color="0.5", linewidth=0.7)
    radial_axes.set(xlabel="radial distortion [%]", ylabel="field [deg]", ylim=(0.0, None))
    radial_axes.spines[["top", "right"]].set_visible(False)
    radial_axes.grid(color="0.92")
    wave = lens.design_wavelength_nm if wavelength_nm is None else wavelength_nm
    figure.suptitle(f"{lens.name}, {wave:g} nm: chief rays, largest displacement {1e3 * largest:.2f} µm", fontsize=10)
    return figure


def draw_image(
    values: ArrayLike,
    axes: Axes | None = None,
    *,
    percentiles: tuple[float, float] = (60.0, 99.97),
    grow: int = 2,
    widest_px: int = 700,
) -> Axes:
    """Image of a star field with a stretch for display: faint stars visible, bright ones not burnt out, none lost.

    Shapes: ``values`` (h, w), ``percentiles`` (float, float), returns (column, row).
    """
    image = np.asarray(values, np.float32)
    height, width = image.shape
    if axes is None:
        size = (6.4, float(np.clip(6.4 * height / width, 1.5, 10.0)))
        axes = Figure(figsize=size, layout="constrained").add_subplot()
    block = max(1, round(width / widest_px))
    rows, columns = height // block * block, width // block * block
    coarse = image[:rows, :columns].reshape(rows // block, block, columns // block, block).max((1, 3))
    low, high = np.percentile(coarse, percentiles)
    scale = max(0.05 * (high - low), 1e-12)
    shown = np.arcsinh(np.clip(grey_dilation(coarse, grow) - low, 0, None) / scale)
    axes.imshow(shown, cmap="gray", extent=(-0.5, columns - 0.5, rows - 0.5, -0.5), interpolation="bilinear")
    axes.grid(visible=False)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="column [px]", ylabel="row [px]")
    return axes
