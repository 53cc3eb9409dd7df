"""Conversion factors; multiply by ``X_Y`` to turn a value in X into a value in Y (IAU/SI definitions)."""

from __future__ import annotations

import math

DEG_RAD = math.pi / 180.0
RAD_DEG = 180.0 / math.pi
ARCSEC_RAD = DEG_RAD / 3600.0
RAD_ARCSEC = 3600.0 * RAD_DEG
UM_MM = 1e-3
