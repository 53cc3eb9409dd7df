"""Derivatives of the image of a scene's stars: from `mi.traverse` parameters to `render.tracing.gradient`."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from render.engine.jit import dr
from render.engine.upload import uploaded
from render.plugins.camera_parameters import plain
from render.tracing.gradient import AttachedPaths, lens_numbers, star_image
from render.tracing.motion.paths import at_rest, star_paths
from render.tracing.tracer import Tracer

Matrix = list[list[Any]]


def attached_image(mi: Any, tracer: Tracer, camera: Any, field: Any) -> Any:
    """Image (h, w, b) of a ``star_field`` through a ``lens_camera``, as a tensor with derivatives."""
    tracer.camera.lens.check_surfaces()
    F, stars, parameters = mi.Float64, field.stars, camera.parameters
    paths = _paths(mi, tracer, camera, field)
    optics, slopes = parameters.derivatives(lambda other: lens_numbers(other, tracer.pupil).values)
    numbers = lens_numbers(optics, tracer.pupil)
    vector, moves = uploaded(F, numbers.values), np.zeros(len(numbers.values), np.bool_)
    for name, at, slope in slopes:
        moves |= slope != 0.0
        number = dr.gather(F, parameters.tensors[name].array, mi.UInt32(at))
        vector = vector + uploaded(F, slope) * (number - dr.detach(number))
    image = star_image(
        mi,
        tracer,
        stars,
        paths,
        camera.exposure_s,
        numbers=numbers,
        vector=vector,
        moves=moves,
        rate=field.photon_rate.array,
    )
    return _on_crop(mi, image, camera, len(stars.band))


def _paths(mi: Any, tracer: Tracer, camera: Any, field: Any) -> AttachedPaths:
    """Directions of a field's stars, with derivatives."""
    F, parameters, motion = mi.Float64, camera.parameters, camera.star_motion
    stars = dr.arange(mi.UInt32, len(field.stars))
    s = [dr.gather(F, field.direction.array, 3 * stars + axis) for axis in range(3)]
    length = dr.rsqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
    world = [component * length for component in s]
    if field.turned:
        world = _applied(_entries(F, field.rotation), world)
    direction = field.turned_stars.direction
    turn = _times(_turn(F, parameters), _entries(F, parameters.tensors["rotation"]))
    if motion is None:
        in_cam = _applied(turn, world)
        return AttachedPaths(at_rest(np.asarray(direction @ camera.camera.rotation_cam_from_world.T)), in_cam, in_cam)
    times = len(motion.weight)
    lane = dr.arange(mi.UInt32, len(field.stars) * times)
    time = lane % times
    if camera.exposure_motion is None:
        middle = _applied(turn, world)
        value, slope = parameters.turning(motion.time_s - 0.5 * motion.exposure_s)
        rate = _parameters(F, parameters.tensors["rate_rad_per_s"])
    else:
        middle, rate = _applied([[F(float(v)) for v in row] for row in motion.rotation_mid], world), []
        value, slope = motion.rotation_cam_from_world, np.zeros((times, 3, 3, 0))
    turned = middle if camera.exposure_motion is None else world
    turned = [dr.gather(F, component, lane // times) for component in turned]

    def entry(i: int, j: int) -> Any:
        columns = [uploaded(F, v[:, i, j]) for v in (value, *np.moveaxis(slope, -1, 0))]
        first, *slopes = (dr.gather(F, v, time) for v in columns)
        return sum((by * change for by, change in zip(slopes, rate, strict=True)), first)

    nodes = _applied([[entry(i, j) for j in range(3)] for i in range(3)], turned)
    return AttachedPaths(star_paths(motion, direction, tracer.camera), middle, nodes, motion.length_px)


def _applied(matrix: Matrix, vector: list[Any]) -> list[Any]:
    """Matrix times vector."""
    return [row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2] for row in matrix]


def _on_crop(mi: Any, image: Any, camera: Any, bands: int) -> Any:
    """The film's crop of a flat image, in single precision."""
    film, width = camera.film(), camera.optics.width_px
    (left, top), (columns, rows) = film.crop_offset(), film.crop_size()
    lane = dr.arange(mi.UInt32, int(rows * columns * bands))
    band, column, row = lane % bands, lane // bands % int(columns), lane // int(bands * columns)
    at = ((row + int(top)) * width + column + int(left)) * bands + band
    return mi.TensorXf(mi.Float(dr.gather(mi.Float64, image, at)), (int(rows), int(columns), bands))


def _parameters(F: Any, tensor: Any) -> list[Any]:
    """Three numbers less their values: zeros with derivatives."""
    index = dr.uint32_array_t(F)
    changes = [dr.gather(F, tensor.array, index(axis)) for axis in range(3)]
    return [change - dr.detach(change) for change in changes]


def _entries(F: Any, tensor: Any) -> Matrix:
    """Entries (3, 3) of a tensor."""
    array = tensor.array
    index = dr.uint32_array_t(F)
    return [[dr.gather(F, array, index(3 * row + column)) for column in range(3)] for row in range(3)]


def _times(left: Matrix, right: Matrix) -> Matrix:
    """Product of two matrices."""
    columns = [_applied(left, [row[j] for row in right]) for j in range(3)]
    return [[column[i] for column in columns] for i in range(3)]


def _turn(F: Any, parameters: Any) -> Matrix:
    """Matrix of ``attitude_rad``, with its derivatives."""
    tensor = parameters.tensors["attitude_rad"]
    value: FloatArray = Rotation.from_rotvec(plain(tensor, (3,))).as_matrix()
    changes = _parameters(F, tensor)
    slope = parameters.turn_derivatives()
    return [
        [sum((float(slope[i, j, k]) * changes[k] for k in range(3)), F(float(value[i, j]))) for j in range(3)]
        for i in range(3)
    ]
