"""Our lenses traced by batoid, with its shapes and its refraction; lengths in mm throughout."""

import numpy as np

from optics import Conic, EvenAsphere, Plane, Sphere


def batoid_surface(batoid, shape):
    match shape:
        case Plane():
            return batoid.Plane()
        case Sphere():
            return batoid.Sphere(shape.radius_mm)
        case Conic():
            return batoid.Quadric(shape.radius_mm, shape.conic)
        case EvenAsphere():
            return batoid.Asphere(shape.radius_mm, shape.conic, list(shape.asphere))


def batoid_rays(batoid, rays, index, wavelength_nm, **more):
    """batoid's rays of ours, in a medium of an index: velocities are direction cosines over it."""
    points, velocity = (rays.x, rays.y, rays.z), (rays.dx / index, rays.dy / index, rays.dz / index)
    return batoid.RayVector(
        *(np.ascontiguousarray(np.ravel(v)) for v in (*points, *velocity)),
        t=np.ravel(rays.opl_mm).copy(), wavelength=np.full(rays.x.size, wavelength_nm * 1e-9), **more,
    )  # fmt: skip


def batoid_trace(batoid, lens, rays, index, wavelength_nm):
    """batoid's rays in the frame of the image plane; ``index`` of all media, from the front of the lens on."""
    rv = batoid_rays(batoid, rays, index[0], wavelength_nm)
    for surface, before, after in zip(lens.surfaces, index[:-1], index[1:], strict=True):
        media = batoid.ConstMedium(before), batoid.ConstMedium(after)
        frame = batoid.CoordSys(surface.position_mm, surface.rotation)
        batoid.refract(batoid_surface(batoid, surface.shape), rv, *media, coordSys=frame)
    batoid.intersect(batoid.Plane(), rv, coordSys=batoid.CoordSys(lens.image_position_mm, lens.image_rotation))
    return rv
