"""The lens and light: surfaces, glass, prescriptions, sequential trace, paraxial optics, perturbations, spectra.

A lens is data (`load_lens` reads it, the functions of `optics.lens.perturb` return changed copies), rays are data
(`star_rays` launches them, `optics.rays.trace.trace` carries them to the image plane), and what they mean is computed
by plain functions (`optics.rays.spots`, `optics.rays.chief`, `optics.rays.paraxial`). One source of the trace runs on
NumPy and on Dr.Jit arrays (`optics.rays.trace.trace_program`). No Mitsuba and no randomness here.

The public names of the package stand in ``__init__.pyi`` and are loaded when they are first used, so that importing one
small module stays cheap; everything else is imported from its module (also `trace` and `paraxial`, which are called
like their modules):

================  ======================================================================================================
optics.lens       surface shapes, the lens record, lens files, tilt, decentre, temperature ...
optics.glass      catalogue glass, refractive index of air, absolute indices on any array library, surroundings
optics.rays       compiled lens, sequential trace, launch disk, chief rays, spots, ABCD quantities, light going the
                  other way
optics.light      spectral energy distributions, filter bands, photon rates from magnitudes, coatings and transmittance
optics.frames     frames and pixel conventions
optics.attitude   attitudes from right ascension, declination and roll, and their errors
optics.figures    lens drawing, spot diagrams, distortion grid
================  ======================================================================================================
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
