"""The inverse model: from images to stars, camera models, attitudes and calibrations. Runs on any FITS image.

`find_stars` measures the stars of an image; `camera_model` is the model of a known camera (`fit_camera` with its
residuals); `identify_stars` identifies stars; `solve_attitude` solves the attitude; `calibrate` fits camera and
attitudes of many frames for a family of attitudes (`FreeAttitudes`, `AttitudeCorrelated`, `GyroLinked`, `NoAttitude`,
`TurntableAttitudes`); `bound` gives its Cramer-Rao bound. Each is one function over modules below it.

The public names of the package are listed in ``__init__.pyi`` and loaded on first use, so that importing one small
module stays fast; everything else is imported from its module:

=================  =====================================================================================================
calib.measure      images, background, detection, centroiders, centroid errors and their bound, ePSFs, circles
calib.cameras      camera models and their fit to a known map, line-of-sight maps
calib.attitude     Wahba's problem, identification, association, attitudes linked by gyros
calib.calibration  camera models and attitudes from many frames, with their bounds
calib.detector     gain, noise and fixed pattern of a detector from its frames
calib.photometry   zero point, colour term, vignetting, extinction, spectral response, atmosphere
calib.psf          PSF over the field and against colour, windows about stars, focus and tilt from widths
calib.directional  directions on the sphere: the Fisher distribution
calib.accuracy     error terms of a star camera from centroids (paper ACC18), and their sum
calib.fitting      least squares, robust loss, solutions
calib.figures      stars marked in an image or on its page, residuals
=================  =====================================================================================================
"""

from importlib.util import find_spec
from pathlib import Path

import lazy_loader

for _name in ("optics", "render"):  # a user's module of that name makes imports fail in strange ways
    _found = find_spec(_name)
    _file = None if _found is None else _found.origin
    if _file and Path(_file).resolve().parents[1] != Path(__file__).resolve().parents[1]:
        raise ImportError(f"{_file} hides the package {_name!r} of starbench; rename it or start elsewhere")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
