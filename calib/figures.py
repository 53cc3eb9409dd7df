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
    """Draw an image of any origin with a stretch that shows faint and bright stars.

    Parameters
    ----------
    image : SensorImage, Frame or (h, w) array
        The image.
    axes : matplotlib.axes.Axes, optional
        Where; in a new figure if left out. ``axes.figure.savefig("stars.png")`` keeps it.

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
        Circles; crosses where a flag speaks against the star.
    identified : Identification or StarAttitude, optional
        Green circles around identified stars, or the stars of the attitude.

    Returns
    -------
    matplotlib.axes.Axes
        The same.
    """
    mine = np.zeros(len(stars), bool)
    if identified is not None:
        mine[identified.detected] = True
    groups: tuple[tuple[Any, dict[str, Any]], ...] = (
        (mine, {"label": "identified", "edgecolors": IDENTIFIED, "facecolors": "none", "s": 34}),
        (~mine & stars.fit, {"label": "star", "edgecolors": FIT, "facecolors": "none", "s": 26}),
        (~mine & ~stars.fit, {"label": "flagged", "color": UNFIT, "marker": "x", "s": 14}),
    )
    for rows, style in groups:
        if rows.any():
            label = f"{np.count_nonzero(rows)} {style.pop('label')}"
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
        What they were identified as; with residuals, if it has them, as arrows from the catalogue's place.

    Returns
    -------
    list of Marks
        For ``Observation.save_page`` or `optics.frame_html.frame_page`; only layers that hold something.
    """
    names = np.full(len(stars), "", object)
    if identified is not None:
        of_catalogue = getattr(identified, "catalogue_id", getattr(identified, "catalogue", None))
        names[identified.detected] = [str(one) for one in np.asarray(of_catalogue)]
    mine = names != ""
    layers = [
        _star_layer(stars, mine, names, name="identified", shape="square", colour=IDENTIFIED),
        _star_layer(stars, ~mine & stars.fit, names, name="measured stars", shape="square", colour=FIT),
        _star_layer(stars, ~mine & ~stars.fit, names, name="flagged", shape="cross", colour=UNFIT),
    ]
    residual = None if identified is None else identified.residual_px
    if identified is not None and residual is not None:
        place = stars.pixel_px[identified.detected] - residual
        layers.append(
            Marks(
                name="residuals of the attitude",
                shape="arrow",
                colour="#e0aaff",
                x_px=place[:, 0],
                y_px=place[:, 1],
                dx_px=residual[:, 0],
                dy_px=residual[:, 1],
            )
        )
    return [layer for layer in layers if len(layer.x_px)]


def _star_layer(stars: StarTable, rows: NDArray[np.bool_], names: NDArray[Any], **style: Any) -> Marks:
    chosen = np.flatnonzero(rows)
    chosen = chosen[np.argsort(-stars.flux_e[chosen], kind="stable")]
    some = stars.select(chosen)
    columns: dict[str, Any] = {
        "catalogue": names[chosen],
        "flux [e-]": some.flux_e,
        "sigma [px]": some.position_sigma_px,
        "background [e-]": some.background_e,
        "flags": [describe_flags(int(value)) for value in some.flags],
    }
    columns = {name: values for name, values in columns.items() if any(str(value) for value in values)}
    return Marks(x_px=some.x_px, y_px=some.y_px, columns=columns, **style)


def draw_residuals(attitude: StarAttitude, stars: StarTable, axes: Axes | None = None, *, scale: float = 500.0) -> Axes:
    """Residuals of an attitude's stars as arrows over the detector; they show errors of camera model or centroider.

    Parameters
    ----------
    attitude : StarAttitude
        Of `solve_attitude`.
    stars : StarTable
        That it was made of.
    axes : matplotlib.axes.Axes, optional
        Where; in a new figure if left out.
    scale : float
        How much longer than the residuals the arrows are.

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
