r"""Glasses that are known by n_d and v_d only: model glasses and six-digit codes of lens files.

Three conditions fix Conrady's formula :math:`n = n_0 + A / \lambda + B / \lambda^{3.5}` (A. E. Conrady, *Applied
Optics and Optical Design*, 1929): the index at the d line, :math:`n_F - n_C = (n_d - 1) / v_d`, and the partial
dispersion :math:`P_{g,F} = 0.6438 - 0.001682 v_d + \Delta P_{g,F}` of normal glasses (SCHOTT TIE-29). Half of the
catalogue's glasses lie within 3.3e-4 of it from 420 to 1000 nm, nineteen of twenty within 9e-4; design programs use
fits of their own for the same two numbers, so the last decimals differ between them.
"""

from __future__ import annotations

import numpy as np

from optics.errors import DomainError
from optics.glass.catalogue import Glass
from optics.glass.dispersion import Dispersion

D_NM, F_NM, C_NM, G_NM = 587.5618, 486.1327, 656.2725, 435.8343
MODEL_ERROR = 3.3e-4
RANGE_NM = (365.0, 1100.0)
CONSTANT_RANGE_NM = (100.0, 30000.0)
"""Range of a constant index, which is stated and no fit of limited range."""


def model_glass(name: str, nd: float, vd: float, *, partial: float = 0.0) -> Glass:
    """Glass through an index and an Abbe number."""
    if not ((1.0 if vd else 0.99) <= nd <= 4.5 and (vd == 0.0 or 9.0 <= vd <= 120.0) and abs(partial) < 0.2):
        raise DomainError(f"n_d = {nd:g}, v_d = {vd:g} (dP_gF = {partial:g}) do not belong to any glass")
    wide = RANGE_NM
    if vd == 0.0:
        dispersion, text, wide = Dispersion.constant(nd), "constant index, as the file states it", CONSTANT_RANGE_NM
    else:
        lines = np.array([D_NM, F_NM, C_NM, G_NM]) * 1e-3
        d, f, c, g = np.stack([np.ones(4), 1.0 / lines, lines**-3.5], axis=1)
        spread = (nd - 1.0) / vd
        normal = 0.6438 - 0.001682 * vd + partial
        coefficients = np.linalg.solve([d, f - c, g - f], [nd, spread, normal * spread])
        dispersion = Dispersion("conrady", tuple(float(x) for x in coefficients))
        text = "Conrady's formula through n_d, v_d and the normal partial dispersion (SCHOTT TIE-29)"
    return Glass(name=name, source=text, dispersion=dispersion, range_nm=wide, maker="model", nd=nd, vd=vd or None)


def glass_code(name: str) -> tuple[float, float] | None:
    """n_d and v_d of a code: ``517642``, ``517.642``, ``620410.603236``, ``1.5168:64.17``; None if it is none."""
    head, colon, tail = name.partition(":")
    if colon:
        try:
            nd, vd = float(head), float(tail)
        except ValueError:
            return None
        return (nd, vd) if 1.0 < nd < 4.5 and 9.0 <= vd <= 120.0 else None
    head, dot, tail = name.partition(".")
    if not dot and len(name) == 6:
        head, tail = name[:3], name[3:]
    digits = head + tail
    if 3 <= len(head) <= 6 and 3 <= len(tail) <= 6 and digits.isascii() and digits.isdigit():
        return 1.0 + int(head) / 10 ** len(head), int(tail) / 10 ** (len(tail) - 2)
    return None
