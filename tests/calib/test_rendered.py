"""On images of our own lens: the ePSF fit finds the traced bundle, whatever the sub-pixel phase and the field."""

from dataclasses import replace

import numpy as np
import pytest
from star_images import image_of

from calib.measure.centroiders.epsf import EpsfCentroider
from calib.measure.stamps import extract_stamps


@pytest.fixture(scope="module")
def rendered():
    """Noiseless image of 36 stars all over the field of the 206 mm lens, its truth and an ePSF for every star."""
    from optics.lens_file import load_lens
    from optics.light.band import TopHat, band_nodes
    from optics.rays.paraxial import axial_paraxial
    from render.camera import build_camera
    from render.detector.spec import load_detector
    from render.engine import Engine
    from render.forward import render_stars
    from render.records import StarField
    from render.tracing.psf import epsf_tracer, render_epsf

    Engine.start()

    lens = load_lens("star_camera_206mm")
    camera = build_camera(lens, load_detector("cmv4000"), defocus_mm=0.01)
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(60.0, 1985.3, 6), np.linspace(60.4, 1985.0, 6)))
    x, y = np.array([x, y]) + np.random.default_rng(1).uniform(-0.5, 0.5, (2, 36))
    focal_mm = float(axial_paraxial(lens, lens.design_wavelength_nm).efl_mm)
    nodes = band_nodes([TopHat(name="600", centre_nm=600.0, width_nm=100.0, edge_nm=5.0)], 8)
    rate = np.broadcast_to(nodes.weight_nm * nodes.transmission, (36, *nodes.weight_nm.shape))
    stars = StarField(
        direction=camera.nominal_direction(x, y, focal_mm),
        wavelength_nm=nodes.wavelength_nm,
        photon_rate=rate * 1.0,
        band=nodes.name,
    )
    image = render_stars(camera, stars, exposure_s=1.0)
    psfs = [row[0] for row in render_epsf(epsf_tracer(camera), stars, oversampling=8)]
    return image, psfs


@pytest.mark.slow
def test_positions_are_the_bundle_means(rendered):
    """Within 2e-4 px: 1e-4 for photon centroid against bundle (renderer), the rest for S-curve and cut wings."""
    image, psfs = rendered
    electrons = image.electrons[:, :, 0].astype(float)
    sensor = image_of(electrons)
    truth_x, truth_y = image.truth.bundle_x_px[:, 0], image.truth.bundle_y_px[:, 0]
    stamps = extract_stamps(sensor, truth_x + 0.1, truth_y - 0.1, background=0.0)
    stamps = replace(stamps, psf_index=np.arange(36))
    table = EpsfCentroider(epsf=psfs).measure(stamps, sensor.noise)
    assert np.all(table.flags == 0)
    phases = np.ptp(truth_x % 1.0), np.ptp(truth_y % 1.0)
    assert min(phases) > 0.5, "the stars must sit at different phases for this to say anything"
    assert np.abs(table.x_px - truth_x).max() < 2e-4
    assert np.abs(table.y_px - truth_y).max() < 2e-4
    truth = image.truth  # the ePSF lacks what the image lacks: light beyond it, and of the far image off the edge
    arrived = truth.electrons_image + truth.electrons_beyond + truth.electrons_off_edge
    assert table.flux_e == pytest.approx(arrived[:, 0], rel=1e-4)
