"""The benches: true values of each, the common rendered laboratory, checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.triad import triad
from calib.calibration.cube_mirror import concentric_angles, normal_of_offset
from experiments.cube.settings import CubeMirrorConfig
from experiments.laboratory.devices.turntable import Turntable, build_turntable
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import ARCSEC_RAD, DEG_RAD
from render.bench.camera import BenchCamera
from render.bench.pictures import screen_light
from render.bench.scene import FACES, BenchGeometry, CubePose, bench_scene, place_cube
from render.bench.sensor import MaskSensor
from render.bench.spot import reflected_spot_mm
from render.detector.spec import Detector, load_detector
from render.engine.random import Streams, stratified, stratified_normal

DATA = Path(__file__).parents[1] / "data"
FACE_ANGLES_DEG = {"+Z": (0.0, 180.0), "+X": (0.0, 90.0), "-X": (0.0, 270.0)}
"""Nominal (outer, inner) angles that turn a face to the light: the cube sits on the back of the sensor."""

NOMINAL_CUBE = np.diag([-1.0, 1.0, -1.0])
"""Table from cube as designed: the cube's Z looks backwards, its X against the table's."""

COVER_LOG2 = 21
"""log2 of the particles for the picture of the covered aperture."""

RIM_PX = 8.0
"""Smallest width of the rim of the spot around the aperture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueBench:
    """True values and errors of a bench; errors in units of their sigma."""

    number: int
    table_from_cube: FloatArray  # (3, 3) Pose of the cube's body
    normal: FloatArray  # (6, 3) Normals of the faces in the body's frame, in the order of `render.bench.scene.FACES`
    sensor_from_table: FloatArray  # (3, 3) R_sr
    sensor: MaskSensor  # Sun sensor as built
    start: FloatArray  # (faces, repeats, 2) Initial offset of the spot, -1 to 1 of ``trim.start_px``
    aim: FloatArray  # (faces, repeats, 2) Aiming error, x and y on the screen
    mounting: FloatArray  # (faces, repeats, 2) Movement of the camera mount
    non_orthogonality: float  # Non-orthogonality of the axes of the table

    def normal_in_table(self, face: str) -> FloatArray:
        """True normal of a face in the table frame (3,)."""
        return np.asarray(self.table_from_cube @ self.normal[list(FACES).index(face)])

    def normal_in_cube(self, face: str, faces: Sequence[str]) -> FloatArray:
        """True normal of a face in the cube's frame (3,), as a certificate of the cube would give it."""
        return np.asarray(self.cube_from_table(faces) @ self.normal_in_table(face))

    def cube_from_table(self, faces: Sequence[str]) -> FloatArray:
        """True R_pr (3, 3): the frame that the first face and the first one not parallel to it define."""
        second = next(face for face in faces if face[1] != faces[0][1])
        return triad(
            [nominal_normal(faces[0]), nominal_normal(second)],
            [self.normal_in_table(faces[0]), self.normal_in_table(second)],
        ).rotation.as_matrix()


@dataclass(frozen=True, slots=True, kw_only=True)
class CubeCase:
    """Errors that act in a Monte-Carlo case, and its method of reduction."""

    name: str  # Key of the case, in names of random streams too
    label: str  # Label in tables and figures
    aim_px: float = 0.0  # 1 sigma of the adjustment error per axis
    non_orthogonal: bool = False  # Non-orthogonality of the axes of the table
    mounting: bool = False  # Movement of the camera mount
    reading: bool = False  # Noise of the angle readings
    # Adjusted from a spot set by eye, in steps of the table, with the operator's gain, until the stopping criterion
    # holds; otherwise the table is continuous, starts trimmed, and makes one correction
    coarse: bool = False
    # Aperture and spot from a single picture, remaining offset subtracted, non-orthogonality of the axes fitted jointly
    # with the sun sensor
    improved: bool = False
    pictures_of: str = ""  # Case whose pictures and readings are reduced; "" for pictures of this case


@dataclass(slots=True, kw_only=True)
class CubeLaboratory:
    """The rendered bench: a Mitsuba scene whose cube is moved, with the camera and the detectors."""

    config: CubeMirrorConfig
    geometry: BenchGeometry
    camera: BenchCamera
    detector: Detector  # Detector of the CCD camera
    sensor_detector: Detector  # Detector of the sun sensor
    scene: Any  # Mitsuba scene
    sensor: Any  # The camera as a Mitsuba sensor
    aperture_e: NDArray[np.float32]  # (h, w) Expected electrons of the picture of the covered, glowing aperture
    streams: Streams  # Root of the random streams

    def light(self, sensor: Any, **options: Any) -> NDArray[np.float32]:
        """Expected electrons (h, w) of a picture of the screen with the cube at its present pose."""
        scale = electrons_per_radiance(self.config)
        parts = self.scene, sensor, self.camera, self.geometry, self.detector
        return screen_light(*parts, electrons_per_radiance=scale, **options)

    @property
    def pitch_mm(self) -> float:
        """Pixel pitch on the screen."""
        return self.camera.pitch_mm

    @property
    def tilt_per_px(self) -> float:
        """Tilt of a face for one pixel of its spot [rad]."""
        return self.pitch_mm / self.geometry.path_mm


def nominal_normal(face: str) -> FloatArray:
    """Normal of a face of a perfect cube in its frame (3,)."""
    axis, sign = FACES[face]
    return np.asarray(sign * np.eye(3)[axis])


def face_start_rad(face: str) -> FloatArray:
    """Nominal angles (2,) [rad] that turn a face to the light."""
    return np.array(FACE_ANGLES_DEG[face]) * DEG_RAD


def build_geometry(config: CubeMirrorConfig) -> BenchGeometry:
    """Sizes of the bench."""
    return BenchGeometry(
        distance_mm=config.screen.distance_mm,
        aperture_mm=config.screen.aperture_mm,
        screen_mm=config.screen.side_mm,
        simulator_mm=config.simulator.diameter_mm,
        simulator_gap_mm=config.simulator.gap_mm,
        source_arcmin=config.simulator.source_arcmin,
        cube_mm=config.cube.side_mm,
        chamfer_mm=config.cube.chamfer_mm,
        cube_offset_mm=np.array(config.cube.offset_mm),
        screen_reflectance=config.screen.reflectance_fraction,
    )


def build_camera(config: CubeMirrorConfig, detector: Detector) -> BenchCamera:
    """The camera as it was aimed."""
    return BenchCamera(
        width_px=detector.width_px,
        height_px=detector.height_px,
        pitch_mm=detector.pixel_pitch_mm,
        distance_mm=config.camera.distance_mm,
        angle_deg=config.camera.angle_deg,
        aim_mm=np.zeros(2),
    )


def build_laboratory(config: CubeMirrorConfig) -> CubeLaboratory:
    """Build the scene and take the picture of the covered aperture, both common to all benches."""
    geometry = build_geometry(config)
    detector = load_detector(config.camera.detector or DATA / "cube_ccd.toml")
    sensor_detector = sun_sensor(config)
    camera = build_camera(config, detector)
    check_bench(config, geometry, camera)
    check_light_levels(config, detector, sensor_detector)
    pose = CubePose.of_table(
        geometry, Rotation.from_euler("y", 180, degrees=True).as_matrix(), NOMINAL_CUBE, PERFECT_NORMALS
    )
    sensor = camera.sensor()
    covered = bench_scene(geometry, pose, covered=True)
    parts: Any = covered, sensor, camera, geometry, detector
    trace: dict[str, Any] = {"covered": True, "log2_particles": COVER_LOG2, "seed": config.seed}
    aperture_e = screen_light(*parts, electrons_per_radiance=electrons_per_radiance(config), **trace)
    return CubeLaboratory(
        config=config,
        geometry=geometry,
        camera=camera,
        detector=detector,
        sensor_detector=sensor_detector,
        scene=bench_scene(geometry, pose, covered=False),
        sensor=sensor,
        aperture_e=aperture_e,
        streams=Streams(config.seed).child("cube"),
    )


PERFECT_NORMALS = np.array([sign * np.eye(3)[axis] for axis, sign in FACES.values()])
"""Normals of a perfect cube, in the order of FACES."""


def electrons_per_radiance(config: CubeMirrorConfig) -> float:
    """Electrons of a pixel for radiance 1 per unit irradiance: the screen in the full beam gives ``plateau_e``."""
    return config.camera.plateau_e * np.pi / config.screen.reflectance_fraction


def build_table(config: CubeMirrorConfig, truth: TrueBench, case: CubeCase) -> Turntable:
    """The table of a bench: outer axis X', inner axis Y'."""
    reading = (config.table.outer_reading_arcsec, config.table.inner_reading_arcsec)
    return build_turntable(
        "xy",
        non_orthogonality_arcsec=config.table.square_arcsec * truth.non_orthogonality if case.non_orthogonal else 0.0,
        reading_noise_arcsec=reading if case.reading else 0.0,
        step_arcsec=config.trim.step_deg * 3600 if case.coarse else 0.0,
    )


def put_cube(laboratory: CubeLaboratory, truth: TrueBench, lab_from_table: FloatArray) -> CubePose:
    """Move the cube of the scene with the table."""
    pose = CubePose.of_table(laboratory.geometry, lab_from_table, truth.table_from_cube, truth.normal)
    place_cube(laboratory.scene, laboratory.geometry, pose)
    return pose


def draw_truths(config: CubeMirrorConfig, streams: Streams) -> list[TrueBench]:
    """The misaligned benches.

    All random numbers are stratified over the benches (Latin hypercube; McKay, Beckman & Conover 1979): each has its
    distribution to 1/count, at any count, so that the scatter of the inputs does not add to the scatter of the results.
    """
    count = config.benches.count
    faces = len(config.cube.faces) * config.cube.repeats
    generator = streams.generator("benches")

    def normals(size: int) -> FloatArray:
        return stratified_normal(generator, count, size)

    shape = (count, len(config.cube.faces), config.cube.repeats, 2)
    mount = normals(3)
    sensor_mount = normals(3)
    face_tilts = normals(12)
    start = 2 * stratified(generator, count, 2 * faces).reshape(shape) - 1
    aim = normals(2 * faces).reshape(shape)
    mounting = normals(2 * faces).reshape(shape)
    non_orthogonality = normals(1)[:, 0]
    sensor_build = normals(3)
    detector = sun_sensor(config)
    return [
        TrueBench(
            number=i,
            table_from_cube=NOMINAL_CUBE @ small_rotation(mount[i] * config.cube.mount_arcmin * 60),
            normal=_tilted_normals(face_tilts[i].reshape(6, 2) * config.cube.square_arcsec),
            sensor_from_table=small_rotation(sensor_mount[i] * config.sensor.mount_arcmin * 60),
            sensor=mask_sensor(config, detector, sensor_build[i]),
            start=start[i],
            aim=aim[i],
            mounting=mounting[i],
            non_orthogonality=float(non_orthogonality[i]),
        )
        for i in range(count)
    ]


def small_rotation(arcsec: FloatArray) -> FloatArray:
    """Rotation matrix of a rotation vector [arcsec]."""
    return np.asarray(Rotation.from_rotvec(arcsec * ARCSEC_RAD).as_matrix())


def _tilted_normals(tilt_arcsec: FloatArray) -> FloatArray:
    """Normals (6, 3) of a cube whose faces are tilted by (6, 2)."""
    normals = PERFECT_NORMALS.copy()
    for i, (axis, _) in enumerate(FACES.values()):
        normals[i, [(axis + 1) % 3, (axis + 2) % 3]] += tilt_arcsec[i] * ARCSEC_RAD
    return np.asarray(normals / np.sqrt((normals**2).sum(axis=1, keepdims=True)))


def sun_sensor(config: CubeMirrorConfig) -> Detector:
    """Detector of the sun sensor."""
    return load_detector(config.sensor.detector or DATA / "cube_sun_sensor.toml")


def mask_sensor(config: CubeMirrorConfig, detector: Detector, build: FloatArray) -> MaskSensor:
    """The sun sensor with errors (3,) of the mask in units of their sigma: gap, centring along x and y."""
    sensor = config.sensor
    return MaskSensor(
        width_px=detector.width_px,
        height_px=detector.height_px,
        pitch_mm=detector.pixel_pitch_mm,
        hole_mm=sensor.hole_um * 1e-3,
        gap_mm=sensor.gap_mm + build[0] * sensor.gap_tolerance_um * 1e-3,
        offset_px=build[1:] * sensor.centring_px,
    )


def start_angles(
    laboratory: CubeLaboratory, truth: TrueBench, table: Turntable, face: int, repeat: int, *, within_px: float
) -> FloatArray:
    """Initial angles of the table (2,) [rad]: the spot is ``start`` times ``within_px`` from the aperture."""
    name = laboratory.config.cube.faces[face]
    offset = truth.start[face, repeat] * within_px * laboratory.pitch_mm
    orthogonal = replace(table, non_orthogonality_arcsec=np.zeros(1))
    normal = normal_of_offset(offset, laboratory.geometry.distance_mm)
    angle = concentric_angles(orthogonal, truth.normal_in_table(name), face_start_rad(name))
    # the normal is tilted by small rotations of the outer axis (x) and the inner axis (y)
    return angle + np.array([-normal[1], normal[0]])


def check_bench(config: CubeMirrorConfig, geometry: BenchGeometry, camera: BenchCamera) -> None:
    """Refuse a bench without a visible rim of the spot, or with a spot beyond the screen or the picture."""
    hole, face = geometry.aperture_mm, geometry.face_mm
    blur = geometry.blur_mm(geometry.path_mm)
    if face < hole:
        raise DomainError(
            f"the aperture of {hole:g} mm is larger than the spot, which a face of {face:g} mm cuts down; the spot "
            "must show around the aperture (screen.aperture_mm, cube.side_mm)"
        )
    rim_px = blur / camera.pitch_mm
    if rim_px < RIM_PX:
        raise DomainError(
            f"the aperture of {hole:g} mm is as large as the spot of {hole + 2 * blur:.4g} mm: a rim of {rim_px:.2g} "
            f"px shows around it, at least {RIM_PX:g} px are needed; make simulator.source_arcmin = "
            f"{config.simulator.source_arcmin:g} or screen.distance_mm larger"
        )
    beam = hole + 2 * geometry.blur_mm(geometry.distance_mm)
    if beam > face:
        raise DomainError(
            f"the beam is {beam:.4g} mm wide at the cube, its face only {face:g} mm; make cube.side_mm larger or "
            "screen.aperture_mm or simulator.source_arcmin smaller"
        )
    start = config.trim.start_px * camera.pitch_mm
    _check_spot(config, geometry, camera, np.array([start, start]), "trim.start_px")


def check_light_levels(config: CubeMirrorConfig, detector: Detector, sensor_detector: Detector) -> None:
    """Refuse exposures that saturate."""
    for key, plateau_e, chip in (
        ("camera.plateau_e", config.camera.plateau_e, detector),
        ("sensor.plateau_e", config.sensor.plateau_e, sensor_detector),
    ):
        limit = 0.9 * chip.saturation_e
        if plateau_e > limit:
            raise DomainError(
                f"{key} = {plateau_e:g} e- saturates {chip.name!r}; at most {limit:.4g} e- (0.9 of full well and "
                "converter) are allowed"
            )


def _check_spot(
    config: CubeMirrorConfig, geometry: BenchGeometry, camera: BenchCamera, spot_mm: FloatArray, hint: str
) -> None:
    """Refuse a spot that is not completely on the screen and in the picture."""
    reach = geometry.aperture_mm / 2 + geometry.blur_mm(geometry.path_mm)
    edge = float(np.max(np.abs(spot_mm)) + reach)
    if edge > geometry.screen_mm / 2:
        raise DomainError(
            f"the spot is off the screen: it reaches {edge:.4g} mm from the aperture, the screen "
            f"{geometry.screen_mm / 2:g} mm; align the cube better by eye ({hint}) or make screen.side_mm larger"
        )
    angle = 2 * np.pi * np.arange(16) / 16
    rim = spot_mm + reach * np.column_stack([np.cos(angle), np.sin(angle)])
    pixel = camera.to_pixel(rim)
    limit = np.array([camera.width_px, camera.height_px]) - 0.5
    if np.any(pixel < -0.5) or np.any(pixel > limit):
        raise DomainError(
            f"the spot of {2 * reach:.4g} mm, {spot_mm[0]:.4g}, {spot_mm[1]:.4g} mm from the aperture, is not wholly "
            f"in the picture of {camera.width_px} x {camera.height_px} px of {camera.pitch_mm * 1e3:g} um; start "
            f"nearer ({hint}) or take a detector with more pixels (camera.detector)"
        )


def check_landing(
    config: CubeMirrorConfig, geometry: BenchGeometry, camera: BenchCamera, pose: CubePose, face: str
) -> None:
    """Refuse a pose in which the beam misses the face or the spot leaves screen or picture."""
    centre, normal = pose.face(face, geometry)
    if normal[2] < 0.5:
        raise DomainError(f"face {face} does not face the light; check the table's angles")
    distance = (centre @ normal) / -normal[2]  # along the beam, from the aperture
    landing = pose.rotation.T @ (np.array([0.0, 0.0, -distance]) - centre)
    half, beam = geometry.face_mm / 2, geometry.aperture_mm / 2 + geometry.blur_mm(geometry.distance_mm)
    offset = float(np.abs(landing).max())
    if offset + beam > half:
        verb = "misses" if offset - beam > half else "is cut by the edge of"
        raise DomainError(
            f"the beam {verb} face {face}: it falls {offset:.4g} mm from the middle of a polished face of "
            f"{geometry.face_mm:g} mm; bring cube.offset_mm nearer to the axes of the table or take a larger cube"
        )
    _check_spot(config, geometry, camera, reflected_spot_mm(geometry, pose, face), "trim.start_px, cube.mount_arcmin")
