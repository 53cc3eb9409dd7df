"""The lens and light: surfaces, glass, prescriptions, sequential trace, paraxial optics, perturbations, spectra.

A lens is data (`load_lens` reads it, the functions of `optics.lens.perturb` return changed copies), rays are data
(`star_rays` launches them, `optics.rays.trace.trace` carries them to the image plane), and what they mean is computed
by plain functions (`optics.rays.spots`, `optics.rays.chief`, `optics.rays.paraxial`). One source of the trace runs on
NumPy and on Dr.Jit arrays (`optics.rays.trace.trace_program`). No Mitsuba and no randomness here.

The names below are loaded when they are first used, so that importing one small module stays cheap; everything else is
imported from its module (also `trace` and `paraxial`, which are called like their modules):

==============  ========================================================================================================
optics.lens     surface shapes, the lens record, lens files, tilt, decentre, temperature ...
optics.glass    catalogue glass, refractive index of air, absolute indices on any array library, surroundings
optics.rays     compiled lens, sequential trace, launch disk, chief rays, spots, ABCD quantities, light going the other
way optics.light    spectral energy distributions, filter bands, photon rates from magnitudes, coatings and
transmittance optics.frames   frames and pixel conventions
optics.figures  lens drawing, spot diagrams, distortion grid
==============  ========================================================================================================
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from optics.errors import StarbenchError
    from optics.glass.catalogue import Glass, get_glass
    from optics.glass.media import CATALOGUE_AIR, VACUUM, Environment
    from optics.lens.prescription import list_lenses, load_lens
    from optics.lens.system import LensSystem, Surface
    from optics.rays.program import compile_lens
    from optics.rays.pupil import entrance_pupil, star_rays
    from optics.rays.spots import lateral_colour, spot_moments
    from optics.rays.trace import Rays, trace_program

__all__ = [
    "CATALOGUE_AIR",
    "VACUUM",
    "Environment",
    "Glass",
    "LensSystem",
    "Rays",
    "StarbenchError",
    "Surface",
    "compile_lens",
    "entrance_pupil",
    "get_glass",
    "lateral_colour",
    "list_lenses",
    "load_lens",
    "spot_moments",
    "star_rays",
    "trace_program",
]

_HOME = {
    "CATALOGUE_AIR": "glass.media",
    "VACUUM": "glass.media",
    "Environment": "glass.media",
    "Glass": "glass.catalogue",
    "LensSystem": "lens.system",
    "Rays": "rays.trace",
    "StarbenchError": "errors",
    "Surface": "lens.system",
    "compile_lens": "rays.program",
    "entrance_pupil": "rays.pupil",
    "get_glass": "glass.catalogue",
    "lateral_colour": "rays.spots",
    "list_lenses": "lens.prescription",
    "load_lens": "lens.prescription",
    "spot_moments": "rays.spots",
    "star_rays": "rays.pupil",
    "trace_program": "rays.trace",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'optics' has no attribute {name!r}")
    return getattr(import_module(f"optics.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
