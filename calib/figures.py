"""Drawings of measurements, without pyplot: stars marked in an image, residuals of an attitude."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calib.attitude.identify import Identification
from calib.attitude.star_attitude import StarAttitude
from calib.flags import describe_flags
from calib.measure.images.sensor_image import as_image
from calib.records import SensorImage, StarTable
from optics.figures import draw_image
from optics.frame_html import Marks
from render.records import Frame

IDENTIFIED, FIT, UNFIT = "#59d98e", "#4aa3df", "#ff5d8f"


def show_image(image: SensorImage | Frame | NDArray[np.float64], axes: Axes | None = None) -> Axes:
    """Draw an image with a stretch for faint and bright stars.

    Parameters
    ----------
    image : SensorImage, Frame or (h, w) array
        The image.
    axes : matplotlib.axes.Axes, optional
        Axes to draw in, of a new figure by default. ``axes.figure.savefig("stars.png")`` writes it.

    Returns
    -------
    matplotlib.axes.Axes
        In pixels: (column, row), row 0 on top.
    """
    sensor = as_image(image)
    return draw_image(np.where(sensor.valid, sensor.dn, np.median(sensor.dn)), axes)


def mark_stars(axes: Axes, stars: StarTable, identified: Identification | StarAttitude | None = None) -> Axes:
    """Mark measured stars in an image.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Of `show_image` or ``Observation.show``.
    stars : StarTable
        Circles; crosses for stars with a flag of `UNFIT`.
    identified : Identification or StarAttitude, optional
        Green circles around identified stars, or the stars of the attitude.

    Returns
    -------
    matplotlib.axes.Axes
        The same.
    """
    styles: dict[str, dict[str, Any]] = {
        "identified": {"edgecolors": IDENTIFIED, "facecolors": "none", "s": 34},
        "star": {"edgecolors": FIT, "facecolors": "none", "s": 26},
        "flagged": {"color": UNFIT, "marker": "x", "s": 14},
    }
    for (name, style), rows in zip(styles.items(), _groups(stars, identified), strict=True):
        if rows.any():
            label = f"{np.count_nonzero(rows)} {name}"
            axes.scatter(*stars.pixel_px[rows].T, linewidths=0.8, label=label, **style)
    if len(stars):
        axes.legend(loc="upper left", fontsize=7, labelcolor="white", facecolor="black", framealpha=0.6)
    return axes


def star_marks(stars: StarTable, identified: Identification | StarAttitude | None = None) -> list[Marks]:
    """Measured stars as layers of a zoomable page: ``observation.save_page("frame.html", star_marks(stars))``.

    Parameters
    ----------
    stars : StarTable
        Shown in three layers: identified, usable, flagged.
    identified : Identification or StarAttitude, optional
        Their catalogue stars; residuals, if any, as arrows from the catalogue's position.

    Returns
    -------
    list of Marks
        For ``Observation.save_page`` or `optics.frame_html.frame_page`; without empty layers.
    """
    names = np.full(len(stars), "", object)
    if identified is not None:
        catalogue = getattr(identified, "catalogue_id", getattr(identified, "catalogue", None))
        names[identified.detected] = [str(star) for star in np.asarray(catalogue)]
    styles = (("identified", "square", IDENTIFIED), ("measured stars", "square", FIT), ("flagged", "cross", UNFIT))
    layers = [
        _star_layer(stars, rows, names, name=name, shape=shape, colour=colour)
        for rows, (name, shape, colour) in zip(_groups(stars, identified), styles, strict=True)
    ]
    if identified is not None and identified.residual_px is not None:
        dx, dy = identified.residual_px.T
        x, y = (stars.pixel_px[identified.detected] - identified.residual_px).T
        style: Any = {"name": "residuals of the attitude", "shape": "arrow", "colour": "#e0aaff"}
        layers.append(Marks(x_px=x, y_px=y, dx_px=dx, dy_px=dy, **style))
    return [layer for layer in layers if len(layer.x_px)]


def _groups(stars: StarTable, identified: Identification | StarAttitude | None) -> list[NDArray[np.bool_]]:
    """Masks (n,) of identified, usable and flagged stars."""
    mask = np.zeros(len(stars), bool)
    if identified is not None:
        mask[identified.detected] = True
    return [mask, ~mask & stars.fit, ~mask & ~stars.fit]


def _star_layer(stars: StarTable, rows: NDArray[np.bool_], names: NDArray[Any], **style: Any) -> Marks:
    index = np.flatnonzero(rows)
    index = index[np.argsort(-stars.flux_e[index], kind="stable")]
    group = stars.select(index)
    columns: dict[str, Any] = {
        "catalogue": names[index],
        "flux [e-]": group.flux_e,
        "sigma [px]": group.position_sigma_px,
        "background [e-]": group.background_e,
        "flags": [describe_flags(int(value)) for value in group.flags],
    }
    columns = {name: values for name, values in columns.items() if any(str(value) for value in values)}
    return Marks(x_px=group.x_px, y_px=group.y_px, columns=columns, **style)


def draw_residuals(attitude: StarAttitude, stars: StarTable, axes: Axes | None = None, *, scale: float = 500.0) -> Axes:
    """Residuals of an attitude's stars as arrows over the detector: errors of camera model or centroider.

    Parameters
    ----------
    attitude : StarAttitude
        Of `solve_attitude`.
    stars : StarTable
        Input of `solve_attitude`.
    axes : matplotlib.axes.Axes, optional
        Axes to draw in, of a new figure by default.
    scale : float
        Length of the arrows over the residuals.

    Returns
    -------
    matplotlib.axes.Axes
        In pixels: (column, row), row 0 on top.
    """
    if axes is None:
        axes = Figure(figsize=(6.4, 6.0), layout="constrained").add_subplot()
        axes.invert_yaxis()
    x, y = stars.pixel_px[attitude.detected].T
    dx, dy = attitude.residual_px.T
    axes.quiver(x, y, scale * dx, scale * dy, angles="xy", scale_units="xy", scale=1.0, width=2e-3, color=FIT)
    axes.set(xlabel="column [px]", ylabel="row [px]", aspect="equal")
    rms = np.sqrt(np.mean(attitude.residual_px**2)) if len(attitude) else np.nan
    axes.set_title(f"{len(attitude)} stars, {rms:.3f} px RMS per axis, arrows {scale:g} times enlarged", fontsize=9)
    return axes
