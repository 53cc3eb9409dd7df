"""Night frames of a camera: noise, false detections, limiting magnitude, time per frame, effect of the epoch.

``python benchmarks/real_frames.py FOLDER --focal-mm 35.287 --pitch-um 6.9 --year 2019.57`` from the repository root
(eight frames in ``test_data`` of github.com/esa/tetra3). Needs tetra3rs. Hot pixels are found over all frames and
left out; stars are identified lost in space; the camera is fitted to all frames; a detection farther than 2.5 px from
every star to G = 10 is false. Times are of one process: of the clock, and of the processor.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from scipy.optimize import curve_fit
from scipy.spatial import cKDTree
from scipy.special import expit

from calib import FreeAttitudes, Observations, calibrate, find_stars, identify_stars, solve_attitude
from calib.cameras import BrownConrady, SensorGeometry
from calib.detector.hot_pixels import find_hot_pixels, without_pixels
from calib.flags import StarFlag, has_flag
from calib.measure.detection.matched_filter import detect, detection_noise
from calib.measure.images.sensor_image import read_images
from render.sky.sky import load_sky

FALSE_PX, NEAR_PX, BORDER_PX, SYSTEMATIC_PX = 2.5, 1.5, 6.0, 0.03


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--focal-mm", type=float, required=True)
    parser.add_argument("--pitch-um", type=float, required=True)
    parser.add_argument("--year", type=float, required=True)
    arguments = parser.parse_args()
    images = list(read_images(sorted(path for path in arguments.folder.iterdir() if path.suffix != ".md")))
    hot = find_hot_pixels(images)
    print(images[0].conversion, hot, sep="\n")
    images = [without_pixels(image, hot.mask) for image in images]
    height, width = images[0].dn.shape
    sensor = SensorGeometry(width_px=width, height_px=height, pixel_pitch_mm=arguments.pitch_um / 1e3)
    camera = BrownConrady.create(sensor, focal_length_mm=arguments.focal_mm)
    sky = load_sky(faintest_mag=9.0)
    measured = []
    for image in images:
        start = time.perf_counter(), time.process_time()
        stars = find_stars(image, "gaussian", fit_background=True, threshold_sigma=6.0)
        identified = identify_stars(stars, camera, sky)
        wall, used = time.perf_counter() - start[0], time.process_time() - start[1]
        attitude = solve_attitude(stars, identified, camera, sky)
        measured.append((stars, attitude))
        trail = int(has_flag(stars.flags, StarFlag.TRAIL).sum())
        found_and_solved = f"{len(stars)} stars, {trail} in trails, {len(attitude)} solved"
        print(f"{image.source}: {found_and_solved}, {wall:.2f} s ({used:.2f} s)")
    for year in (2016.0, arguments.year):
        calibration = fitted(measured, camera, load_sky(faintest_mag=9.0, epoch_year=year, observer="earth"))
        print(f"epoch {year:g}: {calibration.solution.misfit}")
    deep = load_sky(faintest_mag=10.0, epoch_year=arguments.year, observer="earth")
    for sigma in (5.0, 6.0):
        print(f"{sigma:g} sigma: {found(images, calibration, deep, sigma)}")


def fitted(measured, camera, sky):
    """Camera and attitudes from all frames."""
    rows = [attitude.detected[stars.fit[attitude.detected]] for stars, attitude in measured]
    known = [attitude.catalogue[stars.fit[attitude.detected]] for stars, attitude in measured]
    return calibrate(
        Observations.isotropic(
            pixel_px=np.concatenate([one[0].pixel_px[row] for one, row in zip(measured, rows, strict=True)]),
            direction=sky.direction[np.concatenate(known)],
            frame=np.repeat(np.arange(len(rows)), [len(row) for row in rows]),
            sigma_px=np.hypot(
                np.concatenate([one[0].position_sigma_px[row] for one, row in zip(measured, rows, strict=True)]),
                SYSTEMATIC_PX,
            ),
        ),
        camera,
        FreeAttitudes(),
        loss="tukey",
    )


def found(images, calibration, sky, sigma):
    """Stars, false detections as found and as stated, completeness."""
    corner = np.asarray(calibration.model.unproject(calibration.model.geometry.corners_px))[:, 2].min()
    count, false, stated, seen, magnitude = 0, [], 0.0, [], []
    for number, image in enumerate(images):
        noise = detection_noise(image)
        stars = detect(image, threshold_sigma=sigma, noise=noise)
        place = stars.pixel_px[~has_flag(stars.flags, StarFlag.TRAIL)]
        direction = calibration.attitude[number].apply(np.array(sky.direction))
        rows = np.flatnonzero(direction[:, 2] > corner - 0.002)
        known = np.asarray(calibration.model.project(direction[rows]))
        size = np.array(image.dn.shape[::-1])
        inside = np.all((known > BORDER_PX) & (known < size - 1 - BORDER_PX), axis=1)
        within = np.all((place > BORDER_PX) & (place < size - 1 - BORDER_PX), axis=1)
        false.append(int((within & (cKDTree(known).query(place)[0] > FALSE_PX)).sum()))
        seen.append(cKDTree(place).query(known[inside])[0] < NEAR_PX)
        magnitude.append(sky.magnitude[rows[inside]])
        count += len(place)
        stated += float(noise.false_alarms(sigma))
    hit, mag = np.concatenate(seen), np.concatenate(magnitude)
    (limit, _), _ = curve_fit(lambda m, half, width: expit((half - m) / width), mag, hit.astype(float), p0=(8.0, 0.2))
    share = [f"{hit[(mag >= low) & (mag < low + 0.5)].mean():.3f}" for low in np.arange(7.0, 9.0, 0.5)]
    return (
        f"{count} stars; {sum(false)} false in {len(images)} frames, {stated:.2g} stated; half of the stars found at "
        f"G = {limit:.2f}; completeness from G = 7 in steps of 0.5: {', '.join(share)}"
    )


if __name__ == "__main__":
    main()
