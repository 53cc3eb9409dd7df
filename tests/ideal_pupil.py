"""Pupil of an aberration-free lens, from its closed form."""

import numpy as np

from optics.waves.pupil_field import PupilField

WAVE_NM, INDEX = 550.0, 1.00027


def ideal_pupil(sine, hole=0.0, order=(40, 160), index=INDEX):
    """Pupil of a lens without errors that obeys the sine condition: directions fill a disk or an annulus evenly."""
    node, weight = np.polynomial.legendre.leggauss(order[0])
    inner = hole**2
    r = np.sqrt(inner + (1.0 - inner) * 0.5 * (1.0 + node))[:, None]
    angle = 2.0 * np.pi * np.arange(order[1]) / order[1]
    focal = 100.0
    l, m = sine * r * np.cos(angle), sine * r * np.sin(angle)  # noqa: E741
    area = np.broadcast_to(np.pi * (1.0 - inner) * (focal * sine) ** 2 * 0.5 * weight[:, None] / order[1], l.shape)
    zero = np.zeros(l.shape)
    rays = {"pupil_x": focal * l, "pupil_y": focal * m, "area_mm2": area, "x_mm": zero, "y_mm": zero, "l": l, "m": m,
            "n": np.sqrt(1.0 - l**2 - m**2), "path_mm": zero, "jacobian": zero + focal**-2}  # fmt: skip
    return PupilField(
        wavelength_nm=[WAVE_NM], index=[index], ring=r[:, 0], **{name: v[None, None] for name, v in rays.items()}
    )
