r"""Mitsuba BSDF ``lunar_surface``: scattering of light by dust without an atmosphere, after Lommel and Seeliger.

.. math:: \frac{I}{F} = 2 A \frac{\mu_0}{\mu_0 + \mu}

is the radiance over that of a white Lambertian surface lit square on; A (property ``albedo``, a texture) is the normal
reflectance (B. Hapke, *Theory of Reflectance and Emittance Spectroscopy*, 2nd ed., 2012, sec. 8.5; single scattering
with an isotropic phase function). A sphere of it has the geometric albedo A and the phase function

.. math:: \Phi(\alpha) = 1 - \sin\frac{\alpha}{2} \tan\frac{\alpha}{2} \ln \cot\frac{\alpha}{4}.
"""

from __future__ import annotations

import math
from typing import Any

from render.engine.jit import dr


def lommel_seeliger_phase(phase_rad: float) -> float:
    """Light of a Lommel-Seeliger sphere at a phase angle over that at full phase."""
    half = 0.5 * phase_rad
    if half < 1e-6:
        return 1.0
    return 1.0 - math.sin(half) * math.tan(half) * math.log(1.0 / math.tan(0.5 * half))


def define(mi: Any) -> type:
    """The plugin class for Mitsuba's active variant."""

    class LunarSurface(mi.BSDF):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.albedo = props["albedo"]
            self.m_components = [mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            mu, mu0 = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            value = self.albedo.eval(si, active) * (2.0 / math.pi) * mu0 / (mu + mu0)
            return dr.select(active & (mu > 0) & (mu0 > 0), value, 0.0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return dr.select(active & (mi.Frame3f.cos_theta(wo) > 0), mi.warp.square_to_cosine_hemisphere_pdf(wo), 0.0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            sample = dr.zeros(mi.BSDFSample3f)
            sample.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            sample.pdf = mi.warp.square_to_cosine_hemisphere_pdf(sample.wo)
            sample.eta = 1.0
            sample.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
            sample.sampled_component = 0
            ok = active & (sample.pdf > 0)
            return sample, dr.select(ok, self.eval(ctx, si, sample.wo, ok) / sample.pdf, 0.0)

        def to_string(self) -> str:
            return "LunarSurface[]"

    return LunarSurface
