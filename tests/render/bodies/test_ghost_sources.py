"""Ghosts of sources outside the frame: the light that a table states, their names and numbers."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from optics.light.band import TopHat
from render.bodies.ghost_sources import GhostSources, sun_field
from render.catalogue.motion import earth_observer
from render.records import StarField
from render.sky.sunlight import sunlight
from render.tracing.ghosts import GhostTruth

BAND = TopHat(centre_nm=600.0, width_nm=100.0, edge_nm=4.0)
OBSERVER = earth_observer(2020.0)


def ghosts_of(numbers: list[int], electrons: float) -> GhostTruth:
    columns: dict[str, Any] = {name: np.full(len(numbers), electrons) for name in GhostTruth.__dataclass_fields__}
    return GhostTruth(**columns | {"star": numbers})


@dataclass
class HalfFrameGhosting:
    """A lens with one ghost per source, of 1000 e- a pixel in the upper half of the frame."""

    radius_rad: list[float] = field(default_factory=list)

    def bright(self, stars: StarField, exposure_s: float) -> Any:
        return stars.photon_rate.sum((1, 2)) > 1.0

    def add(self, image: Any, direction: Any, wavelength_nm: Any, truth: Any) -> GhostTruth:
        return ghosts_of([], 0.0)

    def add_beside(
        self, image: Any, stars: StarField, *, exposure_s: float, radius_rad: float = 0.0, first: int = 0
    ) -> GhostTruth:
        lit = np.flatnonzero(stars.direction[:, 2] > 0.0)
        image[: len(image) // 2] += 1000.0 * len(lit)
        self.radius_rad.append(radius_rad)
        return ghosts_of([first + int(k) for k in lit], 1000.0)


@dataclass
class Table:
    """Stray light of a table that tells ghosts apart [e-/s per pixel]."""

    light: dict[str, float]
    draws_ghosts: bool = True

    def ghosts(self, attitude: Rotation) -> dict[str, float]:
        return self.light


def stars_along(direction: list[list[float]], rate: list[float]) -> StarField:
    photons = np.array(rate)[:, None, None]
    return StarField(direction=direction, wavelength_nm=[[600.0]], photon_rate=photons, band=("V",))


def added(stray: Table | None, bodies: tuple[str, ...] = ()) -> tuple[Any, GhostTruth, tuple[str, ...], Any]:
    """Image, ghosts and names with the Sun ahead; stars 7 (in the frame), 8 (ahead), 9 (faint) and 10 (behind)."""
    to_sun = OBSERVER.to_sun
    ghosting, ids = HalfFrameGhosting(), np.array([7, 8, 9, 10])
    stars = stars_along([to_sun, to_sun, to_sun, -to_sun], [5.0, 5.0, 0.5, 5.0])
    sources = GhostSources(
        ghosting, stars, ids, exposure_s=0.5, bands=[BAND], observer=OBSERVER, epoch_year=2020.0,
        bodies=bodies, stray=stray,
    )  # fmt: skip
    ahead, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [to_sun])
    image, in_frame = np.zeros((8, 6, 1), np.float32), stars_along([to_sun], [5.0])
    ghosts, names = sources.add(image, ahead, in_frame, ids[:1], None)
    return image, ghosts, names, ghosting


def test_bright_stars_in_front_of_the_lens_alone_have_ghosts():
    image, ghosts, names, _ = added(None)
    assert names == ("8",)
    assert ghosts.star.tolist() == [1]  # behind the star of the frame
    assert image.mean() == pytest.approx(500.0)


def test_ghosts_of_the_sun_hold_the_light_of_the_table():
    """60 e-/s in half a second: a mean of 30 e-, where the paths lead; other bodies keep their traced light."""
    image, ghosts, names, ghosting = added(Table({"sun": 60.0}))
    assert names[:2] == ("8", "sun")
    assert image.mean() == pytest.approx(500.0 + 30.0 + 500.0 * (len(names) - 2))
    assert not image[4:].any()
    assert ghosts.electrons[list(names).index("sun")] == pytest.approx(1000.0 * 30.0 / 500.0)
    assert ghosting.radius_rad[1] == pytest.approx(np.radians(959.63 / 3600.0), rel=0.02)  # 959.63 arcsec at 1 au


def test_ghosts_that_miss_the_frame_are_even_light(monkeypatch):
    monkeypatch.setattr(HalfFrameGhosting, "add_beside", lambda *_, **__: ghosts_of([], 0.0))
    image, ghosts, names, _ = added(Table({"sun": 60.0}))
    np.testing.assert_allclose(image, 30.0)
    assert (len(ghosts), names) == (0, ())


def test_the_sun_as_a_point_has_its_photons():
    sun, radius_rad = sun_field(OBSERVER.from_sun_au, [BAND], nodes=7)
    wave = np.linspace(545.0, 655.0, 20_001)
    photons = np.trapezoid(
        sunlight(wave, distance_au=np.linalg.norm(OBSERVER.from_sun_au)) * BAND.transmission(wave), wave
    )
    assert sun.photon_rate.sum() == pytest.approx(photons, rel=0.02)
    np.testing.assert_allclose(sun.direction[0], OBSERVER.to_sun, atol=1e-12)
    assert radius_rad * np.linalg.norm(OBSERVER.from_sun_au) * 149_597_870.7 == pytest.approx(695_700.0, rel=1e-4)
