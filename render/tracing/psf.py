"""Effective PSFs rendered from the lens: the pixel-integrated image of a star at every sub-pixel phase."""

from __future__ import annotations

from optics.errors import DomainError
from render.camera import Camera
from render.records import EffectivePsf, StarField
from render.tracing.ray_psf import pixel_shares
from render.tracing.tracer import Tracer

__all__ = ["epsf_tracer", "render_epsf"]


TOLERANCE = 2e-4
"""Of the pupil quadrature: an error of this size at half a cycle per pixel and beyond moves a fit by some 1e-5 px."""


def epsf_tracer(camera: Camera) -> Tracer:
    """Tracer for `render_epsf`; hand it on when one camera needs PSFs at many places, so that it is prepared once."""
    return Tracer(camera, tolerance=TOLERANCE)


def render_epsf(
    tracer: Tracer, stars: StarField, *, oversampling: int = 8, half_size_px: int = 7
) -> list[list[EffectivePsf]]:
    """Effective PSF of every star and band, centred on the bundle mean.

    The light of the traced bundle, convolved with the diffusion kernel, is integrated over cells of 1/``oversampling``
    pixel whose edges lie symmetrically about the mean; a pixel at any whole number of cells from the mean is then a sum
    of whole cells, without interpolation.

    Parameters
    ----------
    tracer : Tracer
        Of the camera (`epsf_tracer`).
    stars : StarField
        Where in the field, with which spectra.
    oversampling : int
        Samples per pixel, even.
    half_size_px : int
        Half-width of the grid.

    Returns
    -------
    list of list of EffectivePsf
        ``[star][band]``.

    Raises
    ------
    DomainError
        On an odd oversampling, or what the tracer raises.
    """
    if oversampling < 2 or oversampling % 2:
        raise DomainError(f"render_epsf: oversampling = {oversampling}; an even number of at least 2 is needed")
    cells = tracer.centred_cells(stars, half_size_px=half_size_px, cells_per_px=oversampling)
    share = pixel_shares(cells, oversampling)
    return [[EffectivePsf(values=psf, oversampling=oversampling) for psf in row] for row in share]
