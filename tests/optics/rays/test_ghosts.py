"""Ghosts: path by path against batoid, against plane plates in closed form, and the light counted to the last part."""

from dataclasses import replace

import numpy as np
import pytest
from batoid_trace import batoid_rays, batoid_surface
from lens_texts import plate_lens, table_lens
from made_lens import made_coating

from optics import LensSystem, QuarterWave, field_direction, load_lens, sobol_disk
from optics.rays.entrance_pupil import launch_disks, star_rays
from optics.rays.ghosts import find_ghosts, ghost_pairs, trace_ghost, with_cover_glass

DETECTOR = 2e-3


def batoid_lens(batoid, lens: LensSystem):
    """The same lens: constant shares per surface, clear circles; everything in mm."""
    index = lens.indices(lens.design_wavelength_nm)
    items = []
    for k, surface in enumerate(lens.surfaces):
        item = batoid.RefractiveInterface(
            batoid_surface(batoid, surface.shape),
            name=str(k),
            obscuration=batoid.ObscNegation(batoid.ObscCircle(surface.semi_diameter_mm)),
            coordSys=batoid.CoordSys(surface.position_mm, surface.rotation),
            inMedium=batoid.ConstMedium(index[k]),
            outMedium=batoid.ConstMedium(index[k + 1]),
        )
        shares = surface.coating.split(550.0, 1.0, 1.5) if surface.coating else None
        both = (float(shares.reflectance), float(shares.transmittance)) if shares else (0.0, 1.0)
        item.forwardCoating = item.reverseCoating = batoid.SimpleCoating(*both)
        items.append(item)
    air = batoid.ConstMedium(index[-1])
    detector = batoid.Detector(
        batoid.Plane(), name=str(len(items)), inMedium=air, outMedium=air,
        coordSys=batoid.CoordSys(lens.image_position_mm, lens.image_rotation),
    )  # fmt: skip
    detector.forwardCoating = batoid.SimpleCoating(DETECTOR, 1.0 - DETECTOR)
    return batoid.CompoundOptic([*items, detector], inMedium=batoid.ConstMedium(index[0]), outMedium=air)


@pytest.mark.slow
@pytest.mark.reference
@pytest.mark.parametrize("name", ["star_camera_206mm", "star_tracker_26mm"])
def test_every_path_is_that_of_batoid(name: str) -> None:
    """`traceSplit`: the same paths, the same rays on each, places and shares of light."""
    batoid = pytest.importorskip("batoid")
    lens = load_lens(name)
    coated = {
        k: replace(s, coating=made_coating(1e-3 * (1.0 + 0.1 * k), 2e-3)) for k, s in enumerate(lens.surfaces)
        if lens.media[k] != lens.media[k + 1]
    }  # fmt: skip
    lens, star, wave = lens.with_surfaces(coated), field_direction(1.5, -0.7), lens.design_wavelength_nm
    rays = star_rays(launch_disks(lens, star[None], [wave]), sobol_disk(64, seed=1), star[None], wave)
    rays = replace(rays, **{k: np.ravel(getattr(rays, k)) for k in rays.__dataclass_fields__})
    rv = batoid_rays(batoid, rays, lens.indices(wave)[0], wave, flux=np.ones(64))
    forward, _ = batoid_lens(batoid, lens).traceSplit(rv, minFlux=1e-7)
    theirs = {tuple(map(int, arrived.path)): arrived for arrived in forward}
    end, compared = len(lens.surfaces), 0
    for pair in [None, *ghost_pairs(lens)]:
        got = trace_ghost(lens, pair, rays, np.ones(64), detector_reflectance=DETECTOR, absorption=False)
        j, i = pair or (end, end)
        path = (*range(j + 1), *range(j - 1, i - 1, -1), *range(i + 1, end + 1))
        lit, expected = got.weight > 0.0, theirs.pop(path, None)
        assert lit.sum() == (0 if expected is None else len(expected))
        if expected is None:
            continue
        expected = expected.toCoordSys(batoid.CoordSys(lens.image_position_mm, lens.image_rotation))
        assert got.rays.x[lit] == pytest.approx(expected.x, abs=1e-9)
        assert got.rays.y[lit] == pytest.approx(expected.y, abs=1e-9)
        assert got.weight[lit] * (1.0 - DETECTOR) == pytest.approx(expected.flux, rel=1e-11)
        compared += 1
    assert compared > 40
    assert not theirs


@pytest.mark.parametrize("tilt_deg", [0.0, 35.0])
def test_the_ghost_of_a_plane_plate(tilt_deg: float) -> None:
    """R^2 of the image, in its place and as sharp; R by Fresnel's sines and tangents, s and p averaged per surface."""
    lens = plate_lens(tilt_deg)
    found = find_ghosts(lens, [0.0, 0.0, 1.0], detector_reflectance=0.0, absorption=False)
    at = int(np.argmax((found.back == 1) & (found.forward == 0)))
    air, glass, *_ = lens.indices(550.0)
    into = np.radians(tilt_deg)
    out = np.arcsin(np.sin(into) * air / glass)
    s = np.sin(into - out) / np.sin(into + out) if tilt_deg else (glass - air) / (glass + air)
    p = np.tan(into - out) / np.tan(into + out) if tilt_deg else s
    reflectance = 0.5 * (s**2 + p**2)
    star = np.array([0.0, 0.0, 1.0])
    rays = star_rays(launch_disks(lens, star[None], [550.0]), sobol_disk(8, seed=0), star, 550.0)
    weight = np.ravel(trace_ghost(lens, (1, 0), rays, np.ones(8), absorption=False).weight)
    assert weight[weight > 0.0] == pytest.approx((1.0 - reflectance) ** 2 * reflectance**2, rel=1e-10)
    if not tilt_deg:
        assert found.flux[at] == pytest.approx(reflectance**2, rel=2e-2)  # rays through the rim of the stop
        assert found.rms_mm[at] < 1e-9
        assert found.sharp[at]
    assert found.ledger.total == pytest.approx(1.0, abs=1e-12)


def test_cover_glass_and_detector() -> None:
    """Detector and a face of its window: Rd R and Rd R T^2 of the image; diameter 2 g / N and 2 (g + t / n) / N."""
    lens = with_cover_glass(plate_lens(), "N-BK7", 1.0, 2.0)
    found = find_ghosts(lens, [0.0, 0.0, 1.0], detector_reflectance=0.3, absorption=False)
    air, glass = lens.indices(550.0)[:2]
    reflectance, ratio = ((glass - air) / (glass + air)) ** 2, air / glass
    for face, light, gap in ((4, 1.0, 2.0), (3, (1.0 - reflectance) ** 2, 2.0 + ratio)):
        at = int(np.argmax((found.back == 5) & (found.forward == face)))
        assert found.flux[at] == pytest.approx(0.3 * reflectance * light, rel=2e-2)
        assert found.radius_mm[at] == pytest.approx(gap * 2.0 * 5.0 / 50.0, rel=2e-2)
    star = find_ghosts(lens, field_direction(2.0, 0.0), detector_reflectance=0.3, absorption=False)
    assert star.image_x_mm == pytest.approx(50.0 * np.tan(np.radians(2.0)), abs=2e-3)


@pytest.mark.slow
def test_no_light_is_lost_from_the_books() -> None:
    """Films and mirrors that absorb, rims, glass: what enters is found again to 1e-9."""
    lens = load_lens("star_camera_206mm")
    lossy = lens.with_surfaces({3: replace(lens.surfaces[3], coating=made_coating(0.3, 0.1))})
    found = find_ghosts(lossy, field_direction(0.0, 3.0), wavelength_nm=480.0, coating=QuarterWave())
    parts = found.ledger
    assert parts.total == pytest.approx(1.0, abs=1e-9)
    assert min(parts.image, parts.ghosts, parts.coatings, parts.glass, parts.rims, parts.front, parts.more) > 1e-4
    assert (np.diff(found.flux) <= 0.0).all()
    assert found.brightest_pixel(0.0055) == pytest.approx(
        found.flux * np.minimum(1.0, 0.0055**2 / (2.0 * np.pi * found.rms_mm**2)), rel=1e-12
    )


def test_a_window_before_a_mirror_telescope() -> None:
    """Light goes back over a mirror to the window; the window alone ghosts with R^2 of the image, in its place."""
    rim = {"semi_diameter_mm": 50.0}
    mirror = {"kind": "conic", "radius_mm": -400.0, "conic": -1.0, "thickness_mm": -200.0, "medium": "mirror"}
    lens = table_lens(
        {**rim, "kind": "plane", "thickness_mm": 10.0, "medium": "N-BK7"},
        {**rim, "kind": "plane", "thickness_mm": 300.0, "medium": "air"},
        {**rim, **mirror, "stop": True},
        design_wavelength_nm=550.0,
    )
    found = find_ghosts(lens, [0.0, 0.0, 1.0], detector_reflectance=0.25, absorption=False)
    air, glass, *_ = lens.indices(550.0)
    reflectance = ((glass - air) / (glass + air)) ** 2
    light = dict(zip(zip(found.back, found.forward, strict=True), found.flux, strict=True))
    assert light[1, 0] == pytest.approx(reflectance**2, rel=1e-9)
    # a focus on the detector comes back parallel, and by way of the window to the focus again
    assert light[3, 1] == pytest.approx(0.25 * reflectance, rel=1e-2)
    assert light[3, 0] == pytest.approx(0.25 * reflectance * (1.0 - reflectance) ** 2, rel=1e-2)
    assert found.sharp.all()
    assert found.ledger.total == pytest.approx(1.0, abs=1e-12)
