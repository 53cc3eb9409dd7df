"""`lunar_surface`: the law of Lommel and Seeliger, its sampling, and the phase function of a sphere."""

import math

import numpy as np
import pytest

from render.engine.jit import dr
from render.plugins.lunar_surface import lommel_seeliger_phase

ALBEDO = 0.3


def direction(mi, theta, phi=0.0):
    x, y = math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi)
    return mi.Vector3f(x, y, math.cos(theta))


@pytest.mark.parametrize(("view", "light"), [(0.0, 0.0), (0.5, 1.2), (1.4, 0.1), (0.3, 1.7)])
def test_radiance_factor(mi, view, light):
    """I / F = 2 A mu0 / (mu0 + mu), over pi where F is an irradiance; nothing from below the surface."""
    bsdf = mi.load_dict({"type": "lunar_surface", "albedo": {"type": "uniform", "value": ALBEDO}})
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = direction(mi, view)
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, direction(mi, light, 2.0))
    mu, mu0 = np.cos(view), max(np.cos(light), 0.0)
    assert float(np.ravel(value)[0]) == pytest.approx(2.0 * ALBEDO * mu0 / (mu0 + mu) / np.pi, rel=1e-5)
    assert float(np.ravel(pdf)[0]) == pytest.approx(mu0 / np.pi, rel=1e-5)


def test_samples_integrate_the_law(mi):
    """Reflected light at normal incidence, 2 A (1 - ln 2), from 2^16 samples; standard error 2e-3 of it."""
    bsdf = mi.load_dict({"type": "lunar_surface", "albedo": {"type": "uniform", "value": ALBEDO}})
    rng, count = np.random.default_rng(1), 1 << 16
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.Vector3f(0, 0, 1)
    _, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(0.0), mi.Point2f(*rng.random((2, count)).astype(np.float32)))
    # integral of 2 A mu0 / (1 + mu0) over the hemisphere, over pi
    assert float(np.mean(weight)) == pytest.approx(4.0 * ALBEDO * (1.0 - np.log(2.0)), rel=0.01)


@pytest.mark.parametrize("phase", [0.0, 0.4, 1.5, 2.9])
def test_phase_function_is_that_of_a_sphere(phase):
    """Integral of the law over the lit and visible part of a sphere, in luminance longitude and latitude."""
    node, weight = np.polynomial.legendre.leggauss(80)
    longitude = 0.5 * ((phase - np.pi / 2) + np.pi / 2) + 0.5 * (np.pi - phase) * node
    latitude = 0.5 * np.pi * node
    mu = np.cos(latitude)[:, None] * np.cos(longitude)
    mu0 = np.cos(latitude)[:, None] * np.cos(longitude - phase)
    law = mu * mu0 / (mu + mu0) * np.cos(latitude)[:, None]
    integral = weight @ law @ weight * 0.25 * np.pi * (np.pi - phase)
    assert integral == pytest.approx(0.5 * np.pi * lommel_seeliger_phase(phase), rel=1e-6)
