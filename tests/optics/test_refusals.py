"""What optics refuses: kind of error, and the name, value or range that its message holds, grouped by room."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ideal_pupil import ideal_pupil
from lens_refusals import ROOMS as LENS_ROOMS
from lens_texts import plate_lens
from made_lens import made_glass
from refusals import Row, rows

from optics import QuarterWave, decentre, distortion_map, field_direction, get_glass, load_lens, tilt, with_wavefront
from optics.attitude import attitude_from_angles
from optics.errors import ConfigError, ConvergenceError, DomainError
from optics.frames import field_angles_deg
from optics.lens.heated_lens import Housing, ThermalState
from optics.light import magnitudes, pst
from optics.light.band import BandNodes, TabulatedBand, TopHat, band_nodes
from optics.light.band_file import load_band
from optics.light.bsdf import HarveyShack, Particles, area_coverage, particles_per_mm2, roughness_tis
from optics.light.spectrum import Blackbody, TabulatedSed
from optics.light.transmission import AxialLayout, lens_transmission
from optics.rays.entrance_pupil import entrance_pupil
from optics.rays.ghosts import find_ghosts, ghost_irradiance, with_cover_glass
from optics.rays.lateral_colour import lateral_colour
from optics.rays.paraxial import image_of, paraxial
from optics.rays.performance import lens_performance
from optics.rays.photocentre import photocentres_of
from optics.rays.polychromatic_spots import polychromatic_spots
from optics.rays.pupil_sampling import gauss_disk, sobol_disk
from optics.rays.spots import spot_moments
from optics.rays.surface_scatter import imaging_rays, scattered_irradiance
from optics.rays.thermal_sensitivity import thermal_sensitivity
from optics.rays.trace import Rays, trace
from optics.rays.vignetted_pupil import vignetted_pupils
from optics.response import Response
from optics.waves.pupil_field import needed_order
from optics.waves.wavefront import PathMap, zernike_map
from optics.waves.zernike import zernike_numbers

NAN, INF = math.nan, math.inf

# --- rays, waves, light

CAMERA, GAUSS = load_lens("star_camera_206mm"), load_lens("double_gauss_50mm")
HOUSING, AXIS, WINDOW = Housing(expansion_per_k=23.6e-6), [0.0, 0.0, 1.0], np.linspace(-0.05, 0.05, 5)
HUBBLE, FLAT = load_lens("hubble_57m"), np.linspace(-1.0, 1.0, 9)
STAR = Blackbody(temperature_k=6000.0)


def ray(direction: Any = AXIS, x_mm: float = 0.0, wavelength_nm: float = 600.0) -> Rays:
    return Rays.create(x_mm=x_mm, y_mm=0.0, direction=direction, wavelength_nm=wavelength_nm)


def without_rims() -> Any:
    surfaces = tuple(replace(surface, semi_diameter_mm=INF) for surface in CAMERA.surfaces)
    return vignetted_pupils(replace(CAMERA, surfaces=surfaces), np.array([AXIS]), [600.0], rings=3, arms=8)


def photocentres(spectrum: Any) -> Any:
    return photocentres_of(spot_moments(CAMERA, 0.0, 0.0, [500.0, 600.0], order=(1, 4)), spectrum)


def scattered(source: Any, number: int | None = None) -> Any:
    laws = {} if number is None else {"dust": {number: np.ones_like}}
    return scattered_irradiance(imaging_rays(load_lens("star_tracker_26mm"), np.array([AXIS])), source, laws)


def thermal_shift() -> Any:
    narrow = thermal_sensitivity(CAMERA, HOUSING, corner_deg=0.1, wavelength_nm=[600.0], count=6)
    return narrow.shift(ThermalState(mean_k=1.0), field_direction(5.0, 0.0))


PLATE = plate_lens()
RAYS = [
    *rows(DomainError, find_ghosts, (PLATE, AXIS, {"detector_reflectance": 1.2}, ["detector_reflectance = 1.2", "1"])),
    *rows(DomainError, with_cover_glass,
        (PLATE, "N-BK7", -1.0, 2.0, {}, ["-1 mm", "must be positive"]),
        (PLATE, "N-BK7", 40.0, 30.0, {}, ["no room", "40 mm"])),
    *rows(DomainError, ghost_irradiance, (PLATE, [1.0, 0.0, 0.0], (5.0, 5.0), {}, ["90 deg"])),
    *rows(DomainError, scattered, ([0.0, 0.0, -1.0], {}, ["90 deg"]), (AXIS, 5, {}, ["surface 5"])),
    *rows(DomainError, paraxial,
        (tilt(CAMERA, "L2", 0.1), {}, ["tilted or decentred"]),
        (decentre(CAMERA, "L2", 0.1), {}, ["decentred"]),
        (replace(CAMERA, surfaces=CAMERA.surfaces[:1]), {}, ["no refracting or reflecting surface"])),
    *rows(DomainError, image_of, (CAMERA, paraxial(CAMERA).front_focus_z_mm, {}, ["front focal plane"])),
    *rows(DomainError, lens_performance, (CAMERA, [1.0, 2.0], [600.0], {}, ["1 deg", "relative to field 0"])),
    *rows(DomainError, photocentres,
        ([1.0], {}, ["spectrum of shape (1, 1)", "(s, 2)"]),
        *((bad, {}, ["negative, not finite or without light"]) for bad in ([1.0, -1.0], [0.0, 0.0], [1.0, NAN]))),
    *rows(DomainError, sobol_disk, (1000, {"seed": 1}, ["1000 Sobol points", "power of two"])),
    *rows(DomainError, gauss_disk, (0, 4, {}, ["0 rings x 4 arms", "at least 1 x 1"])),
    *rows(ConvergenceError, entrance_pupil, (decentre(GAUSS, "L6", 60.0), {}, ["no ray of any field"])),
    *rows(ConvergenceError, spot_moments, (GAUSS, [40.0], [0.0], 600.0, {}, ["no ray"])),
    *rows(DomainError, spot_moments,
        (CAMERA, [[0.0]], [[0.0]], 600.0, {}, ["shape (1, 1)", "one-dimensional"]),
        (CAMERA, 0.0, 0.0, 3000.0, {}, ["3000 nm", "2500 nm"])),
    *rows(DomainError, distortion_map, (CAMERA, {"count": 1}, ["1 x 1", "at least 2 x 2"])),
    *rows(DomainError, lateral_colour, (CAMERA, 1.0, 0.0, 600.0, {"of": "centroid"}, ["'centroid'", "'chief'"])),
    *rows(ConvergenceError, polychromatic_spots, (GAUSS, [0.0, 40.0], [0.0, 0.0], [600.0], [1.0], {}, ["no light"])),
    *rows(ConvergenceError, without_rims, ({}, ["no aperture"])),
    *rows(DomainError, thermal_shift, ({}, ["outside the field", "0.07"])),
    *rows(DomainError, thermal_sensitivity, (CAMERA, HOUSING, {"count": 3}, ["3 x 3 stars", "at least 6"])),
    *rows(ConvergenceError, thermal_sensitivity, (CAMERA, HOUSING, {"step_k": 60.0}, ["60 and 120 K", "smaller"])),
    *rows(DomainError, ray,
        ([0.0, 0.0, -1.0], {}, ["does not travel towards the lens"]),
        (AXIS, NAN, {}, ["not finite"]),
        ([0.0, 1.0], {}, ["shape (2,)", "(..., 3)"])),
    *rows(DomainError, trace, (CAMERA, ray(wavelength_nm=250.0), {}, ["250 nm is outside"])),
]  # fmt: skip


def masked_map() -> Any:
    error = np.zeros((9, 9))
    error[2, 3] = NAN
    return PathMap(x=FLAT, y=FLAT, error_nm=error)


def coarse_image() -> Any:
    return ideal_pupil(0.17, order=(16, 64)).intensity(WINDOW, WINDOW)


def half_map(x: float) -> Any:
    return PathMap(x=0.5 * FLAT, y=FLAT, error_nm=np.zeros((9, 9)))(x, 0.0)


def third_error() -> Any:
    error = zernike_map([0.0, 0.0, 0.0, 1.0])
    return with_wavefront(with_wavefront(with_wavefront(HUBBLE, error), error), error)


DEFOCUSED = ideal_pupil(0.17, order=(12, 32)).shifted(20.0)
WAVES = [
    *rows(DomainError, masked_map, ({}, ["1 of 81", "row 2, column 3"])),
    *rows(DomainError, half_map, (0.9, {}, ["x = -0.5 ... 0.5", "0.900", "the whole pupil"])),
    *rows(DomainError, third_error, ({}, ["no surface can carry"])),
    *rows(DomainError, zernike_map, ([0.0, NAN, 1.0], {}, ["Zernike coefficient 1 of 3 is not finite"])),
    *rows(ConfigError, zernike_numbers, (4, "frine", {}, ["frine", "did you mean fringe"])),
    *rows(DomainError, zernike_numbers, (38, "fringe", {}, ["38 Zernike terms", "at most 37"])),
    *rows(DomainError, coarse_image, ({}, ["16 rings x 64 azimuths is too coarse", "x 13"])),
    *rows(DomainError, needed_order, (DEFOCUSED, 0.05, {}, ["rad along a radius"])),
    *rows(DomainError, ideal_pupil, (0.7, {}, ["44 deg", "scalar theory of diffraction"])),
]


def top_hat(**change: float) -> TopHat:
    return TopHat(**({"centre_nm": 600.0, "width_nm": 100.0} | change))  # type: ignore[arg-type]


def band(wave: Any, value: Any, source: str = "test") -> TabulatedBand:
    return TabulatedBand(name="bad", source=source, wavelength_nm=np.array(wave), value=np.array(value))


def sed(wave: Any, value: Any, quantity: Any = "photon", source: str = "test") -> TabulatedSed:
    return TabulatedSed(name="s", source=source, wavelength_nm=wave, value=value, quantity=quantity)


def response(value: Any, source: str = "test") -> Response:
    return Response(name="qe", source=source, wavelength_nm=np.array([400.0, 700.0]), value=np.array(value))


def layout(index: float = 1.5, thickness_mm: float = 10.0, **change: Any) -> AxialLayout:
    plate = {"media": (made_glass(index), None), "thickness_mm": np.array([thickness_mm, 0.0])}
    return AxialLayout(**(plate | change))


def written(read: Callable[[Path], Any], name: str, kind: type[Exception], *cases: tuple[str, ...]) -> list[Row]:
    """Rows of a file: its text, and the words of the message."""

    def call(folder: Path, text: str) -> Any:
        (folder / name).write_text(text, encoding="utf-8")
        return read(folder / name)

    return [(f"{name} {words[0]}", lambda f, t=text: call(f, t), kind, [*words]) for text, *words in cases]


GAP = band([500.0, 510.0, 520.0, 680.0, 690.0, 700.0], [0.0, 1.0, 0.0, 0.0, 1.0, 0.0])
LIGHT = [
    *rows(DomainError, top_hat,
        ({"width_nm": 0.0}, ["width 0 nm"]),
        ({"centre_nm": NAN}, ["centre nan nm"]),
        ({"edge_nm": 101.0}, ["edge 101 nm", "0 ... 100 nm"]),
        ({"peak": 1.5}, ["1.5", "0 ... 1"]),
        ({"peak": 0.0}, ["0 excluded"]),
        ({"centre_nm": 40.0}, ["below 0 nm"])),
    *rows(DomainError, band,
        ([600.0, 500.0], [0.5, 0.5], {}, ["500 nm follows 600 nm", "must increase"]),
        ([500.0, 600.0], [0.5, 1.1], {}, ["value 1.1 at 600 nm"]),
        ([500.0, 600.0], [NAN, 0.5], {}, ["nan"]),
        ([500.0, 600.0], [0.0, 0.0], {}, ["opaque"])),
    *rows(ConfigError, band, ([1.0, 2.0], [1.0, 1.0], "", {}, ["source"])),
    *rows(ConfigError, band_nodes, ([], 4, {}, ["no band"])),
    *rows(DomainError, band_nodes, ([top_hat()], 0, {}, ["0 nodes"]), ([GAP], 5, {}, ["opaque at 600 nm", "5 nodes"])),
    *rows(DomainError, top_hat(edge_nm=10.0).transmission, ([500.0, NAN], {}, ["NaN"])),
    ("nodes", lambda _: BandNodes(name=("a",), wavelength_nm=np.ones((1, 3)), weight_nm=np.ones((1, 4)),
                                  transmission=np.ones((1, 3))), DomainError, ["shape (1, 4)"]),
    *written(
        load_band, "green.csv", DomainError,
        ("500,0\n510,80\n520,0\n", "green.csv: transmissions up to 80", "transmission_percent"),
        ("0.5,0\n0.51,0.8\n0.52,0\n", "up to 0.52: nanometres"),
        ("500,0\n520,0.5\n510,0.7\n", "wavelengths must increase"),
        ("500,0\n510,-0.2\n520,0.5\n", "-0.2 at 510 nm"),
        ("500,0\n510,0\n520,0\n", "opaque"),
    ),
    *written(
        load_band, "green.csv", ConfigError,
        ("nm, %\n500,0\n510,80\n", "line 1: write the header as wavelength_nm, transmission_percent"),
        ("500,0\n510,high\n520,0\n", "line 2: '510,high': a wavelength and a value"),
        ("500,0\n", "1 rows"),
        ("500,0\n510,nan\n520,0\n", "line 2", "NaN"),
    ),
    ("band file", lambda folder: load_band(folder / "absent.csv"), ConfigError, ["absent.csv: no such file"]),
    *rows(ConfigError, magnitudes.photon_rate, (STAR, 0.0, {"wavelength_nm": 550.0, "system": "B"}, ["known: G, V"])),
    *rows(DomainError, magnitudes.photon_rate,
        (STAR, [1.0, NAN], {"wavelength_nm": 550.0}, ["magnitude nan"]),
        (STAR, 0.0, {"wavelength_nm": -550.0}, ["-550 nm", "outside 1"]),
        (sed([500.0, 600.0], np.ones(2)), 0.0, {"wavelength_nm": 550.0}, ["500 to 600 nm", "470 ... 700 nm"])),
    *rows(DomainError, magnitudes.synthetic_magnitude,
        (sed([300.0, 900.0, 1100.0], [0.0, 0.0, 1.0]), {}, ["no light in the V passband"])),
    *written(
        pst.read_pst, "pst.csv", ConfigError,
        ("angle_deg\n10\n", "no PST column"),
        ("x,y\n1,2\n", "angle_deg"),
        ("angle_deg,pst\n10,none\n", "not a table of numbers"),
        ("angle_deg,azimuth_deg,pst\n10,0,1\n20,0,1\n10,90,1\n30,90,1\n", "the same angles"),
        ("angle_deg,pst\n10,1\n10,2\n", "the same angles, each once"),
    ),
    *written(
        pst.read_pst, "pst.csv", DomainError,
        ("angle_deg,pst\n10,-1e-6\n", "-1e-06", "not be negative"),
        ("angle_deg,pst\n100,1e-6\n", "within 0 ... 90 deg", "100"),
    ),
    ("PST absent", lambda folder: pst.read_pst(folder / "none.csv"), ConfigError, ["none.csv", "cannot be read"]),
    *rows(DomainError, area_coverage, (0.5, {}, ["cleanliness level 0.5 is outside 1"])),
    *rows(DomainError, roughness_tis, (100.0, 500.0, 1.0, -1.0, {}, ["not smooth", "0.3"])),
    *rows(DomainError, HarveyShack, ({"b0": 1.0, "shoulder": -1.0, "slope": -2.0}, ["shoulder = -1"])),
    *rows(DomainError, particles_per_mm2, (100.0, 200.0, {}, ["between 1 um and the level, 100 um"])),
    *rows(DomainError, Particles, ({"level": 300.0, "wavelength_nm": 600.0, "forward": 1.5}, ["forward = 1.5"])),
    *rows(DomainError, Blackbody, *(({"temperature_k": t}, [f"{t:g} K"]) for t in (0.0, NAN))),
    *rows(DomainError, STAR.photon_density, (NAN, {}, ["nan nm"])),
    *rows(DomainError, sed,
        ([500.0, 400.0], [1.0, 1.0], {}, ["400 nm follows 500 nm"]),
        ([400.0, 500.0], [1.0, -1.0], {}, ["value -1 at 500 nm"]),
        ([400.0, 500.0], [1.0, NAN], {}, ["nan"]),
        ([400.0, 500.0], [0.0, 0.0], {}, ["zero everywhere"]),
        ([400.0, 500.0], [1.0], {}, ["shape"]),
        ([400.0], [1.0], {}, ["two points"]),
        ([-5.0, 500.0], [1.0, 1.0], {}, ["-5 nm is not positive"])),
    *rows(ConfigError, sed, ([400.0, 500.0], [1.0, 1.0], "watt", {}, ["'watt'", "neither 'photon' nor 'power'"])),
    *rows(ConfigError, sed, ([400.0, 500.0], [1.0, 1.0], "power", "", {}, ["source"])),
    *rows(DomainError, sed([400.0, 500.0], [1.0, 1.0]).photon_density, (600.0, {}, ["600 nm", "400 ... 500 nm"])),
    *rows(ConfigError, lens_transmission, ("star_camera", 550.0, {}, ["a lens or a layout is needed, got str"])),
    *rows(DomainError, lens_transmission,
        (layout(), 550.0, {}, ["no internal transmittance"]),
        (layout(media=(get_glass("N-BK7"), None)), 250.0, {}, ["N-BK7: wavelength 250 nm"])),
    *rows(DomainError, layout, (1.5, -1.0, {}, ["-1 mm is negative"]), ({"media": (None,)}, ["shape (2,)"])),
    *rows(DomainError, QuarterWave, ({"design_wavelength_nm": 100.0}, ["MgF2: wavelength 100 nm"])),
    *rows(ConfigError, response, ([0.5, 0.5], "", {}, ["source"])),
    *rows(DomainError, response, ([0.5, 1.5], {}, ["outside 0 ... 1"])),
    *rows(DomainError, response([0.2, 0.8]).interpolate,
        ([500.0, 701.0], {}, ["qe: wavelength 701 nm is outside 400 ... 700 nm"]),
        ("green", {}, ["not a number in nm"])),
]  # fmt: skip

FRAMES = [
    *rows(DomainError, field_direction,
        *((*angles, {}, ["field angle", "-90 and 90 deg"]) for angles in ((90.0, 0.0), (0.0, -120.0), (NAN, 0.0)))),
    *rows(DomainError, field_angles_deg, ([0.0, 0.0, -1.0], {}, ["behind the camera"])),
    *rows(DomainError, attitude_from_angles,
        (0.0, 91.0, {}, ["91 deg", "outside -90 ... 90"]),
        (NAN, 0.0, {}, ["must be finite"])),
]  # fmt: skip

ROOMS = {**LENS_ROOMS, "rays": RAYS, "waves": WAVES, "light": LIGHT, "frames": FRAMES}


@pytest.mark.parametrize(
    ("call", "kind", "words"),
    [pytest.param(*row[1:], id=f"{room}: {row[0]}") for room, table in ROOMS.items() for row in table],
)
def test_refusals(call: Callable[[Path], Any], kind: type[Exception], words: list[str], tmp_path: Path) -> None:
    with pytest.raises(kind) as error:
        call(tmp_path)
    message = str(error.value)
    assert "\n" not in message
    assert [word for word in words if word not in message] == []
