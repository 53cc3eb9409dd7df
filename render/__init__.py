"""The forward model: real sky, star sensor, frames with their truth.

A star sensor is a lens and a detector by name (`load_star_sensor`), the sky a catalogue as an observer sees it
(`load_sky`), and a frame the sensor's output in an attitude (`observe`, `SkySimulator`). Below them, for scenes of
one's own: stars as light at wavelengths (`StarField`), electrons without noise (`StarRenderer`), the detector
(`expose`), and the plugins of Mitsuba (`render.plugins`).

The public names of the package are listed in ``__init__.pyi`` and loaded on first use, so that importing one small
module stays fast and needs no Mitsuba; everything else is imported from its module:

================  ======================================================================================================
render.catalogue  star catalogues: Gaia offline, files; motion, temperatures, search tree
render.sky        stars of a field and their light, zodiacal light, uniform skies
render.tracing    stars through lenses: pupils, quadrature, images, truth
render.detector   EMVA 1288 detectors: noise, maps, readout, radiation, cosmic rays
render.motion     trajectories, jitter, gyros
render.bodies     Moon, planets, bodies lit by the Sun
render.fits       FITS files and world coordinates
render.engine     where Dr.Jit and Mitsuba run; random streams
================  ======================================================================================================
"""

from importlib.util import find_spec
from pathlib import Path

import lazy_loader

for _name in ("optics",):  # a user's module of that name makes imports fail in strange ways
    _found = find_spec(_name)
    _file = None if _found is None else _found.origin
    if _file and Path(_file).resolve().parents[1] != Path(__file__).resolve().parents[1]:
        raise ImportError(f"{_file} hides the package {_name!r} of starbench; rename it or start elsewhere")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
