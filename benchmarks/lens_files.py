"""Import of a folder of Zemax and CODE V files, as a table, with rays compared with optiland's.

    python benchmarks/lens_files.py FOLDER [--catalogues FOLDER] [--peer]

Every .zmx and .seq below FOLDER is read: exactly, with approximations, or refused with its reason. With ``--peer`` the
files are read by optiland's own reader too (pip install optiland), its glasses are given our indices, and 49 parallel
rays are traced by both, so that differences are of geometry. Files in which the other reader has other surfaces are
listed. batoid (pip install batoid) reads no such files: its coordinate systems, surfaces and media are put together
from the prescription that was read, by its own turns and shifts, and traced with the same rays.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from optics.errors import StarbenchError
from optics.lens_file import LensFile, read_lens_file
from optics.rays.paraxial import axial_paraxial
from optics.rays.trace import Rays, trace

FLAT_MM = 1e25
"""Radius of a plane for batoid, whose formula does not know infinity."""


NEWTON = 1e-14
"""How near optiland's iteration has to come to an asphere [mm]; its own limit of 1e-6 leaves 1e-7 mm in the image."""


def files_below(folder: Path) -> Iterator[Path]:
    """Lens files, in the order of their names."""
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in (".zmx", ".seq") and path.is_file():
            yield path


def bundle(file: LensFile) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start x, y [mm] and direction of 49 parallel rays that fill half of the entrance pupil, in front of the lens."""
    assert file.defaults is not None
    radius = 0.25 * file.defaults.entrance_pupil_mm
    radius = radius if 0.0 < radius < 1e4 else 0.25
    x, y = map(np.ravel, np.meshgrid(*(np.linspace(-1.0, 1.0, 7) * radius,) * 2))
    tilt = np.radians(0.3 * min(file.lens.max_field_deg, 10.0))
    try:
        pupil_mm = axial_paraxial(file.lens, file.lens.design_wavelength_nm).entrance_pupil_z_mm
    except StarbenchError:
        pupil_mm = 0.0
    if abs(pupil_mm) < 1e5:
        y = y - (pupil_mm + 5.0) * np.tan(tilt)
    return x, y, np.array([0.0, np.sin(tilt), np.cos(tilt)])


def peer_rays(path: Path, file: LensFile) -> tuple[np.ndarray, np.ndarray] | str:
    """Global points [mm] of the rays in the image plane by optiland, or why they cannot be had."""
    from optiland.fileio import load_codev_file, load_zemax_file
    from optiland.materials import IdealMaterial
    from optiland.rays import RealRays

    lens, wave = file.lens, file.lens.design_wavelength_nm
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            load = load_zemax_file if path.suffix.lower() == ".zmx" else load_codev_file
            optic = load(str(path))
            group: Any = optic.surface_group
            found = len(group.surfaces) - 2
            if found != len(lens.surfaces):
                return f"it finds {found} surfaces, the file has {len(lens.surfaces)}"
            air = lens.indices(wave)[0]
            for surface, own, index in zip(group.surfaces[1:-1], lens.surfaces, lens.indices(wave)[1:], strict=True):
                surface.geometry.tol = NEWTON
                if not own.mirror:
                    surface.material_post = IdealMaterial(n=float(index / air))
            x, y, d = bundle(file)
            one = np.ones_like(x)
            rays = RealRays(x, y, -5.0 * one, d[0] * one, d[1] * one, d[2] * one, one, 1e-3 * wave * one)
            optic.surface_group.trace(rays, skip=1)
            return np.asarray(rays.x, float), np.asarray(rays.y, float)
        except Exception as error:  # another program's reader may fail in any way
            return f"{type(error).__name__}: {str(error)[:60]}"


def batoid_surface(table: dict[str, Any]) -> Any:
    """The batoid surface of a prescription's surface; KeyError for a kind that batoid lacks."""
    import batoid

    kind, radius, conic = table.get("kind", "conic"), table.get("radius_mm", np.inf), table.get("conic", 0.0)
    if kind not in ("plane", "sphere", "conic", "even_asphere"):
        raise KeyError(kind)
    terms = table.get("asphere", ())
    if np.isinf(radius) and not any(terms):
        return batoid.Plane()
    if conic == -1.0:  # where the formula of other conics divides by 0
        conics = batoid.Paraboloid(radius)
        return batoid.Sum([conics, batoid.Asphere(FLAT_MM, 0.0, list(terms))]) if any(terms) else conics
    return batoid.Asphere(min(radius, FLAT_MM), conic, list(terms)) if any(terms) else batoid.Quadric(radius, conic)


def batoid_frame(frame: Any, table: dict[str, Any]) -> Any:
    """A coordinate system after the shift and the turn of a table."""
    import batoid

    shift = [*table.get("decentre_mm", (0.0, 0.0)), 0.0][:3]
    angles = np.radians([*table.get("tilt_deg", (0.0, 0.0)), 0.0][:3])
    turns = [turn(angle) for turn, angle in zip((batoid.RotX, batoid.RotY, batoid.RotZ), angles, strict=True)]
    turned = frame if table.get("first") == "tilt" else frame.shiftLocal(shift)
    for turn in turns if table.get("axes") == "moving" else turns[::-1]:
        turned = turned.rotateLocal(turn)
    return turned.shiftLocal(shift) if table.get("first") == "tilt" else turned


def batoid_rays(file: LensFile) -> tuple[np.ndarray, np.ndarray] | str:
    """Global points [mm] of the rays in the image plane by batoid, or why they cannot be had."""
    import batoid

    lens, wave = file.lens, file.lens.design_wavelength_nm
    x, y, d = bundle(file)
    index = iter(lens.indices(wave))
    before = float(next(index))
    velocity = np.broadcast_to(d / before, (len(x), 3))
    rays = batoid.RayVector(x, y, np.full(len(x), -5.0), *velocity.T, wavelength=wave * 1e-9)
    frame = batoid.CoordSys()
    for table in file.tables["surface"]:
        own = batoid_frame(frame, table)
        if table.get("kind") != "coordinate_break":
            if table.get("carry") == "bend" and np.count_nonzero(table.get("tilt_deg", ())) > 1:
                return "a mirror that bends the axis twice"
            try:
                surface = batoid_surface(table)
            except KeyError as error:
                return f"batoid has no {error.args[0]}"
            after = float(next(index))
            if table["medium"] == "mirror":
                batoid.reflect(surface, rays, own)
            else:
                batoid.refract(surface, rays, batoid.ConstMedium(before), batoid.ConstMedium(after), own)
            before = after
        if table.get("kind") == "coordinate_break" or table.get("carry") == "forward":
            frame = own
        elif table.get("carry") == "bend":  # the turn of the mirror once more; a shift is the mirror's own
            again = {key: table[key] for key in ("tilt_deg", "axes") if key in table}
            frame = batoid_frame(own, again)
        frame = frame.shiftLocal([0.0, 0.0, table.get("thickness_mm", 0.0)])
    frame = batoid_frame(frame, file.tables.get("image", {}))
    batoid.intersect(batoid.Plane(), rays, frame)
    points = frame.origin + rays.r @ frame.rot.T
    lost = rays.failed
    return np.where(lost, np.nan, points[:, 0]), np.where(lost, np.nan, points[:, 1])


def difference(peer: tuple[np.ndarray, np.ndarray] | str, file: LensFile) -> str:
    """Largest difference of the rays in the image plane, or why there is none."""
    if isinstance(peer, str):
        return peer
    x, y, d = bundle(file)
    wave = file.lens.design_wavelength_nm
    bare = {i: replace(s, semi_diameter_mm=np.inf, apertures=()) for i, s in enumerate(file.lens.surfaces)}
    lens = file.lens.with_surfaces(bare)  # the bundle of an off-axis lens may pass beside its rims
    own = trace(lens, Rays.create(x_mm=x, y_mm=y, z_mm=-5.0, direction=d, wavelength_nm=wave))
    points = np.stack([own.x, own.y, np.zeros_like(own.x)], -1) @ lens.image_rotation.T + lens.image_position_mm
    arrived = np.asarray(own.ok) & np.isfinite(peer[0])
    if not arrived.any():
        return "no ray arrives in both"
    apart = np.hypot(points[:, 0] - peer[0], points[:, 1] - peer[1])[arrived]
    return f"{apart.max():.1e} mm ({arrived.sum()} rays)"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--catalogues", type=Path, help="folder of AGF files")
    parser.add_argument("--peer", action="store_true", help="compare rays with optiland and batoid")
    options = parser.parse_args()
    catalogues = (
        sorted(p for p in options.catalogues.iterdir() if p.suffix.lower() == ".agf") if options.catalogues else []
    )
    counts: Counter[str] = Counter()
    print(f"| file | became | why{' | rays against optiland | against batoid' if options.peer else ''} |")
    print("|---|---|---" + ("|---|---|" if options.peer else "|"))
    for path in files_below(options.folder):
        rays = ""
        try:
            file = read_lens_file(path, catalogues=catalogues)
            assert file.report is not None
            inexact = [
                line
                for line in file.report.inexact
                if line.line or line.command not in ("field", "object", "clear apertures")
            ]
            became = "approximated" if inexact else "read"
            why = "; ".join(dict.fromkeys(f"{line.command[:24]}: {line.message[:70]}" for line in inexact[:2]))
            if options.peer:
                rays = f"{difference(peer_rays(path, file), file)} | {difference(batoid_rays(file), file)}"
        except StarbenchError as error:
            became, why = "refused", str(error).replace(f"{path.parent}{os.sep}", "").split(": ", 1)[-1][:140]
        counts[became] += 1
        print(f"| {path.name} | {became} | {why.replace('|', '/')}{f' | {rays}' if options.peer else ''} |")
    print("\n" + ", ".join(f"{number} {name}" for name, number in sorted(counts.items())))


if __name__ == "__main__":
    main()
