"""Text of ``starbench lens thermal``: the sensitivity matrix, and spacers that hold the focus."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from optics.errors import ConfigError, DomainError
from optics.lens.heated_lens import COMPONENTS, Housing
from optics.lens.system import LensSystem
from optics.rays.thermal_sensitivity import (
    Athermal,
    ThermalSensitivity,
    athermal_spacer,
    spacers_of,
    thermal_sensitivity,
)
from render.sensor_file.housing import expansion_per_k

NAMES = dict(
    zip(
        COMPONENTS,
        ("mean", "front to detector", "across, +x less -x", "across, +y less -y", "elements, rim less centre"),
        strict=True,
    )
)


def thermal_lines(
    lens: LensSystem,
    housing: Housing,
    second: str | float,
    *,
    corner_deg: float | None = None,
    spacers: Sequence[str] = (),
) -> Iterator[str]:
    """Lines for the terminal; ``second`` is the material that compensating spacers are made with."""
    lens.check_glass()
    try:
        second_per_k = expansion_per_k(second)
    except ValueError as error:
        raise ConfigError(f"--second {second}: {error}") from None
    change = thermal_sensitivity(lens, housing, corner_deg=corner_deg)
    yield f"{lens.name}: housing {1e6 * housing.expansion_per_k:g} ppm/K, focal length {change.focal_length_mm:.4g} mm"
    yield from _matrix(change)
    yield ""
    yield f"spacers that hold the focus, the others {1e6 * housing.expansion_per_k:g} ppm/K:"
    yield "  in front of  length [mm]  expansion [ppm/K]  left at +20 K [um]  second material [mm]"
    for name in spacers or spacers_of(lens):
        try:
            yield _spacer(athermal_spacer(lens, housing, spacer=name), housing, second_per_k)
        except DomainError:
            if spacers:
                raise
            yield f"  {name:11s} none within +-10000 ppm/K"


def _matrix(change: ThermalSensitivity) -> Iterator[str]:
    yield ""
    yield (
        "per kelvin                   focus    scale    boresight x, y  distortion  colour  map fit   step\n"
        "                              [um]    [ppm]          [arcsec]    [arcsec]    [um]     [nm]"
    )
    for row, name in enumerate(COMPONENTS):
        x, y = (value if abs(value) > 5e-5 else 0.0 for value in change.boresight_arcsec_per_k[row])
        yield (
            f"{NAMES[name]:26s} {change.focus_um_per_k[row]:+7.3f} {_plain(change.scale_ppm_per_k[row]):+8.2f} "
            f"{x:+8.3f} {y:+8.3f} {change.distortion_arcsec_per_k[row]:11.4f} {change.colour_um_per_k[row]:7.4f} "
            f"{1e6 * change.fit_error_mm_per_k[row]:8.3f} {change.step_error[row]:6.0e}"
        )


def _plain(value: float) -> float:
    return value if abs(value) > 5e-3 else 0.0


def _spacer(spacer: Athermal, housing: Housing, second_per_k: float) -> str:
    housing_per_k = housing.expansion_per_k
    length = "–" if housing_per_k == second_per_k else f"{spacer.second_material_mm(housing_per_k, second_per_k):.2f}"
    return (
        f"  {spacer.spacer:11s} {spacer.length_mm:12.3f} {1e6 * spacer.expansion_per_k:18.2f} "
        f"{spacer.focus_um_at_20_k:19.3f} {length:>21s}"
    )
