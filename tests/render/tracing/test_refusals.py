"""What engine, tracing and plugins refuse: kind of error, and the name, value or range that its message holds.

Mitsuba wraps what a plugin raises into an error of its own.
"""

from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from star_emitters import film, star_emitter

from optics.errors import BackendError, ConfigError, ConvergenceError, DomainError
from optics.light.bsdf import HarveyShack
from optics.light.collimation import Collimation
from render.engine import Engine
from render.engine.jit import dr
from render.engine.llvm import check_llvm
from render.engine.random import Streams
from render.forward import star_scene
from render.motion.trajectory import ConstantRate
from render.plugins.camera_properties import share_camera
from render.records import StarField
from render.tracing.ghosts import GhostLight
from render.tracing.motion.exposure import NODE_LADDER, exposure_motion
from render.tracing.psf import epsf_tracer, ray_epsf, render_epsf
from render.tracing.tracer import Tracer

GOOD_STARS = {"direction": [[0.0, 0.0, 1.0]], "wavelength_nm": [[600.0]], "photon_rate": [[[1.0]]], "band": ("a",)}
FILM = film(300, 200)
SENSOR = {
    "type": "lens_camera", "lens": "star_camera_206mm", "pixel_pitch_um": 5.5, "charge_diffusion_um": 1.0, "film": FILM
}  # fmt: skip
AXIS = np.array([[0.0, 0.0, 1.0]])
ONE, LINES = np.ones(1), np.array([[500.0, 600.0]])
Call = Callable[[Any, Any], Any]
"""Of Mitsuba and the `bench` of the renderer's tests."""


def camera(bench: Any, **changes: Any) -> Any:
    return bench.camera_of(film=False, **changes)


def rendered(exposure_s: float = 1.0, camera: Any = None, **settings: Any) -> Call:
    def call(_: Any, bench: Any) -> Any:
        used = bench.camera_of(**({"film": False} | (camera or {})))
        return Tracer(used, **settings).render(bench.stars_at(used, 2000, 1000, nodes=1), exposure_s=exposure_s)

    return call


def traced(**stars: Any) -> Call:
    return lambda _, bench: Tracer(camera(bench)).bundle_means(StarField(**(GOOD_STARS | stars)))


def moving(
    px: float = 1.0, line: float = 0.0, start_s: float = 0.0, exposure_s: float = 0.4, open_s: float = 0.4, **more: Any
) -> Call:
    """A camera whose image moves along the columns; a star at rest in it during an exposure."""

    def call(_: Any, bench: Any) -> Any:
        used = camera(bench, name="star_tracker_26mm")
        rate = np.array([px / exposure_s * used.pixel_pitch_mm / 26.0 if exposure_s else 1e-3, 0.0, 0.0])
        path = ConstantRate(initial=Rotation.identity(), rate_rad_per_s=rate, end_s=2.0)
        motion = exposure_motion(path, start_s=start_s, exposure_s=exposure_s, camera=used, line_time_s=line)
        stars = bench.stars_at(used, 500.0, 500.0, nodes=1)
        return Tracer(used).render(stars, exposure_s=open_s, motion=motion, **more)

    return call


def loaded(plugin: dict[str, Any], **changes: Any) -> Call:
    def call(mi: Any, _: Any) -> Any:
        values = {key: value(mi) if callable(value) else value for key, value in (plugin | changes).items()}
        return mi.load_dict({key: value for key, value in values.items() if value is not None})

    return call


def shared(film: dict[str, Any] | None = None, to_world: Any = None) -> Call:
    """A sensor of a camera record of 4096 x 2048 px."""

    def call(mi: Any, bench: Any) -> Any:
        size = {"width": 4096, "height": 2048}
        more = {} if to_world is None else {"to_world": to_world(mi)}
        properties = {"camera": share_camera(bench.camera_of()), "film": film or FILM | size, **more}
        return mi.load_dict({"type": "lens_camera", **properties})

    return call


def stars(direction: np.ndarray = AXIS) -> dict[str, Any]:
    return star_emitter(direction, LINES, np.ones((len(direction), 1, 2)))


def scene(**changes: Callable[[Any], Any]) -> Call:
    """A scene with our integrator, rendered."""

    def call(mi: Any, _: Any) -> Any:
        contents = {"type": "scene", "integrator": {"type": "star_tracer"}, "sensor": SENSOR, "stars": stars()}
        contents |= {name: value(mi) for name, value in changes.items()}
        return mi.render(mi.load_dict({name: value for name, value in contents.items() if value is not None}))

    return call


def parameter(key: str, at: Any) -> Call:
    """A number of a lens that a surface has not."""

    def call(mi: Any, _: Any) -> Any:
        params = mi.traverse(mi.load_dict({"type": "scene", "sensor": SENSOR, "stars": stars()}))
        values = np.array(params[f"sensor.{key}"].numpy(), float)
        values[at] = 0.1
        params[f"sensor.{key}"] = mi.TensorXf64(values)
        params.update()

    return call


def motion_table(count: int = 3, **changes: Any) -> Call:
    table = np.ascontiguousarray(np.broadcast_to(np.eye(3), (1, count, 3, 3)))
    usual = {"motion_duration_s": 1.0, "line_time_s": 0.0, "shutter_close": 1.0}
    return loaded(SENSOR | usual, motion_rotation=lambda mi: mi.TensorXf64(table), **changes)


def differentiated(motion: bool = False, **changes: Any) -> Call:
    """The gradient of an image by its light."""

    def call(mi: Any, bench: Any) -> Any:
        used = bench.window(bench.camera_of(**changes), 16, 500.0, 500.0)
        stars = bench.stars_at(used, 8.0, 8.0, nodes=1)
        loaded = mi.load_dict(star_scene(used, stars))
        params = mi.traverse(loaded)
        dr.enable_grad(params["stars.photon_rate"])
        dr.backward(dr.sum(mi.render(loaded, params), axis=None))

    return call


def llvm(version: tuple[int, ...], drjit: str = "1.4.0", printed: str = "") -> Call:
    def call(*_: Any) -> Any:
        with patch("render.engine.llvm.install_advice", return_value="install it"):
            check_llvm(version, drjit, printed=printed)

    return call


ENGINE = [
    ("backend", lambda *_: Engine.start("opencl"), BackendError, ["'opencl'", "auto, llvm, cuda"]),
    ("variant", lambda *_: Engine("llvm", "double").mitsuba, BackendError, ["llvm_double", "llvm_ad_mono"]),
    ("no LLVM", llvm((-1, -1, -1)), BackendError, ["was not found; install"]),
    ("old LLVM", llvm((14, 0, 6)), BackendError, ["LLVM 14 is too old"]),
    ("old LLVM by Dr.Jit", llvm((-1,), printed="LLVM version (14) is too old."), BackendError, ["LLVM 14 is too old"]),
    ("aborting pair", llvm((15, 0, 6), "1.5.0"), BackendError, ["ends the process on LLVM 15", "mitsuba==3.9.0"]),
    *[(f"seed {seed!r}", lambda *_, seed=seed: Streams(seed), DomainError, [f"seed = {seed!r}", "at least 0"])
      for seed in (-1, 1.5, "7")],
    *[(f"frame {n}", lambda *_, n=n: Streams(1).key("photon", n), DomainError, [f"frame = {n}", "0 to 2^64 - 1"])
      for n in (-1, 2**64)],
]  # fmt: skip
TRACING = [
    ("star behind", traced(direction=-AXIS), DomainError, ["star 0 lies behind the camera (180.0 deg"]),
    ("wavelength", traced(wavelength_nm=[[2600.0]]), DomainError, ["2600 nm", "290 ... 2500 nm", "N-FK51A"]),
    ("negative wavelength", traced(wavelength_nm=[[-5.0]]), DomainError, ["wavelength_nm", "-5 nm"]),
    ("negative rate", traced(photon_rate=[[[-1.0]]]), DomainError, ["photon_rate of star 0", "-1 photons/s/mm^2"]),
    ("direction", traced(direction=[[0.0, np.inf, 1.0]]), DomainError, ["direction", "index [0, 1] is inf"]),
    ("length", traced(direction=[[0.0, 0.1, 1.0]]), DomainError, ["direction[0] has length 1.00498"]),
    ("bands", traced(band=("a", "b")), DomainError, ["wavelength_nm", "shape (1, 1) where (2, 1)"]),
    *[(f"exposure {t}", rendered(t), DomainError, [f"exposure {t} s", "positive"]) for t in (0.0, np.nan)],
    ("huge spot", rendered(camera={"defocus_mm": 30.0, "film": True}, sobol_log2_rays=8), DomainError,
     ["star 0 is", "at most 1024 px", "defocus_mm = 30 mm"]),
    ("huge diffraction image", rendered(camera={"defocus_mm": 4.0, "diffraction": "waves", "film": True}), DomainError,
     ["defocus_mm = 4 mm", "set diffraction = 'rays', which suffices for such images"]),
    ("diffraction", lambda _, bench: camera(bench, diffraction="wave"), ConfigError, ["'wave'", "did you mean waves"]),
    ("duration", moving(exposure_s=0.0), DomainError, ["exposure_s = 0.0 s", "positive"]),
    ("line time", moving(line=-1.0), DomainError, ["line_time_s = -1.0 s", "0 (global shutter) or positive"]),
    ("start", moving(start_s=np.nan), DomainError, ["start_s = nan s"]),
    ("end", moving(start_s=1.9), DomainError, ["outside of the trajectory", "0 to 2 s"]),
    ("long path", moving(px=1e4), ConvergenceError, [f"a path that {NODE_LADDER[-2]} time nodes do not resolve"]),
    ("fast image", moving(px=16.0, line=1e-2), DomainError, ["rows per line time (0.01 s)", "up to 0.2"]),
    ("shutter", moving(open_s=0.1), DomainError, ["exposure of 0.1 s with a motion of 0.4 s"]),
    ("attitude", moving(rotation_cam_from_world=np.eye(3)), ConfigError, ["an attitude and a motion are given"]),
    ("odd samples", lambda _, bench: render_epsf(epsf_tracer(camera(bench)), bench.stars_at(camera(bench), 5.0, 5.0),
     oversampling=3), DomainError, ["oversampling = 3", "even number of at least 2"]),
    ("dark star", lambda _, bench: render_epsf(epsf_tracer(camera(bench)), bench.stars_at(camera(bench), 0, 0,
     direction=np.array([[np.sin(0.9), 0.0, np.cos(0.9)]]))), DomainError, ["star 0: none of its light reaches"]),
    ("no rays", lambda *_: ray_epsf(ONE, ONE, 0.0 * ONE, diffusion_px=0.1), DomainError, ["no light"]),
    ("ghost's light", lambda *_: GhostLight(least_e=0.0), DomainError, ["least_e = 0 e-"]),
    ("detector", lambda *_: GhostLight(least_e=1.0, detector_reflectance=1.5), DomainError, ["reflectance", "0 ... 1"]),
    ("scatter", lambda _, bench: camera(bench, scatter=HarveyShack(b0=1e5, shoulder=0.01, slope=-2.0)), DomainError,
     ["scatter"]),
    ("decreasing wavelengths", lambda *_: Collimation(wavelength_nm=LINES[:, ::-1], slope_rad=np.zeros((1, 2, 2)),
     vergence_per_mm=np.zeros((1, 2))), DomainError, ["wavelengths that increase"]),
    ("collimated bands", traced(wavelength_nm=[[500.0], [600.0]], photon_rate=np.ones((1, 2, 1)), band=("a", "b"),
     collimation=Collimation(wavelength_nm=LINES, slope_rad=np.zeros((1, 2, 2)), vergence_per_mm=np.zeros((1, 2)))),
     DomainError, ["of 1 bands, the field of 2"]),
]  # fmt: skip
PLUGINS = [
    ("lens", loaded(SENSOR, lens="star_camera_206m"), RuntimeError,
     ["ConfigError: unknown lens 'star_camera_206m'", "star_camera_206mm"]),
    ("no lens", loaded(SENSOR, lens=None), RuntimeError, ["ConfigError: lens_camera: property 'lens' is missing"]),
    ("no pitch", loaded(SENSOR, pixel_pitch_um=None), RuntimeError, ["property 'pixel_pitch_um' is missing"]),
    ("pitch", loaded(SENSOR, pixel_pitch_um=-5.5), RuntimeError, ["pixel_pitch_um = -5.5 um; it must be positive"]),
    ("handle", loaded(SENSOR, camera="camera-0"), RuntimeError, ["ConfigError: unknown camera handle 'camera-0'"]),
    ("glass", loaded(SENSOR, wavelength_nm=150.0), RuntimeError, ["DomainError", "150 nm", "N-FK51A"]),
    ("diffusion", loaded(SENSOR, charge_diffusion_um=-1.0), RuntimeError, ["Camera.charge_diffusion_px"]),
    ("shutter", loaded(SENSOR, shutter_open=2.0), RuntimeError, ["hutter opening time"]),
    ("property", loaded(SENSOR, defocus_m=1.0), RuntimeError, ["unreferenced property", '"defocus_m"']),
    ("rotation", loaded(SENSOR, rotation="1 0 0"), RuntimeError, ["rotation needs nine numbers"]),
    ("scale", loaded(SENSOR, to_world=lambda mi: mi.ScalarTransform4f().scale(2.0)), RuntimeError,
     ["to_world scales by 2; give scene_unit_mm"]),
    ("attitude", shared(to_world=lambda mi: mi.ScalarTransform4f().rotate([0, 1, 0], 10.0)), RuntimeError,
     ["a shared camera has its own attitude"]),
    ("film", shared(film=FILM), RuntimeError, ["film of 300 x 200 px for a camera of 4096 x 2048 px"]),
    ("duration of attitudes", motion_table(motion_duration_s=0.0), RuntimeError, ["motion_duration_s = 0 s"]),
    ("line time", motion_table(line_time_s=-1.0), RuntimeError, ["line_time_s = -1 s not negative"]),
    ("attitudes", motion_table(count=1), RuntimeError, ["(1, 3, 3)", "m >= 2"]),
    ("closed shutter", motion_table(shutter_close=0.0), RuntimeError, ["needs shutter_open"]),
    ("no stars", loaded({}, type="star_field"), RuntimeError, ["star_field: property 'direction' is missing"]),
    ("star bands", lambda mi, _: mi.load_dict(stars() | {"band": "one,two"}), RuntimeError,
     ["DomainError: StarField.wavelength_nm: shape (1, 2) where (2, 2)"]),
    ("star property", lambda mi, _: mi.load_dict(stars() | {"flux": 1.0}), RuntimeError, ['"flux"']),
    ("star file", loaded({}, type="star_field", filename=__file__), RuntimeError,
     ["ConfigError: star_field:", "is not a file that save_star_field wrote"]),
    ("rays", loaded({}, type="star_tracer", sobol_log2_rays=99), RuntimeError, ["sobol_log2_rays = 99", "6 ... 26"]),
    ("tolerance", loaded({}, type="star_tracer", tolerance=0.0), RuntimeError, ["tolerance = 0; it must be positive"]),
    ("empty sky", scene(stars=lambda mi: None), ConfigError, ["0 star_field emitters; exactly one is needed"]),
    ("two skies", scene(more=lambda _: stars()), ConfigError, ["2 star_field emitters"]),
    ("pinhole", scene(sensor=lambda _: {"type": "perspective", "film": FILM}), ConfigError, ["lens_camera is needed"]),
    ("stars behind", scene(stars=lambda mi: stars(-AXIS)), DomainError, ["star 0 lies behind the camera"]),
    ("blurred film", scene(sensor=lambda mi: SENSOR | {"film": FILM | {"rfilter": {"type": "gaussian"}}}), ConfigError,
     ["reconstruction filter would blur"]),
    ("silhouettes", lambda mi, _: mi.load_dict(SENSOR).projection_transform(), ConfigError, ["prb_projective"]),
    ("conic", parameter("conic", 1), DomainError, ["is a sphere; it has no conic"]),
    ("stop", parameter("tilt_deg", (0, 0)), DomainError, ["is a separate stop"]),
    ("gradient", differentiated(charge_diffusion_px=0.0), ConfigError, ["star 0 has no derivative", "by sobol"]),
]  # fmt: skip


@pytest.mark.parametrize(
    ("call", "kind", "words"),
    [pytest.param(*row[1:], id=row[0].replace(" ", "-")) for row in (*ENGINE, *TRACING, *PLUGINS)],
)
def test_refusals_of_the_renderer(call: Call, kind: type[Exception], words: list[str], mi: Any, bench: Any) -> None:
    with pytest.raises(Exception) as caught:  # noqa: PT011  the kind may be that of the cause
        call(mi, bench)
    error: BaseException = caught.value
    while error.__cause__ is not None and not isinstance(error, kind):
        error = error.__cause__
    assert isinstance(error, kind)
    assert [word for word in words if word not in str(error)] == []
    assert kind is RuntimeError or "\n" not in str(error)
