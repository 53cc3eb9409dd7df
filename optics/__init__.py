"""The lens and light: surfaces, glass, prescriptions, sequential trace, paraxial optics, perturbations, spectra.

A lens is data (`load_lens` reads it, the functions of `optics.perturb` return changed copies), rays are data
(`star_rays` launches them, `optics.trace.trace` carries them to the image plane), and what they mean is computed by
plain functions (`optics.analysis`, `optics.chief`, `optics.paraxial`). One source of the trace runs on NumPy and on
Dr.Jit arrays (`optics.trace.trace_program`). No Mitsuba and no randomness here.

The names below are loaded when they are first used, so that importing one small module stays cheap; everything else is
imported from its module (also `trace` and `paraxial`, which are called like their modules):

========================  ==============================================================================================
optics.prescription       lens files
optics.surface, .lens     shapes, surfaces, the lens record
optics.glass, .air        catalogue glass, refractive index of air
optics.media              absolute indices on any array library, surroundings
optics.program, .trace    compiled lens, sequential trace
optics.pupil              launch disk and its sampling
optics.frames             frames and pixel conventions
optics.paraxial           ABCD quantities
optics.chief, .analysis   chief rays, distortion; spots, lateral colour, vignetting, best focus
optics.perturb, .reverse  tilt, decentre, temperature ...; light going the other way
optics.figures            lens drawing, spot diagrams, distortion grid
optics.spectrum, .band    spectral energy distributions, filter bands
optics.photometry         photon rates from magnitudes
optics.transmission       coatings and internal transmittance
========================  ==============================================================================================
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from optics.analysis import lateral_colour, spot_moments
    from optics.errors import StarbenchError
    from optics.glass import Glass, get_glass
    from optics.lens import LensSystem, Surface
    from optics.media import CATALOGUE_AIR, VACUUM, Environment
    from optics.prescription import list_lenses, load_lens
    from optics.program import compile_lens
    from optics.pupil import entrance_pupil, star_rays
    from optics.trace import Rays, trace_program

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
    "CATALOGUE_AIR": "media",
    "VACUUM": "media",
    "Environment": "media",
    "Glass": "glass",
    "LensSystem": "lens",
    "Rays": "trace",
    "StarbenchError": "errors",
    "Surface": "lens",
    "compile_lens": "program",
    "entrance_pupil": "pupil",
    "get_glass": "glass",
    "lateral_colour": "analysis",
    "list_lenses": "prescription",
    "load_lens": "prescription",
    "spot_moments": "analysis",
    "star_rays": "pupil",
    "trace_program": "trace",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'optics' has no attribute {name!r}")
    return getattr(import_module(f"optics.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
