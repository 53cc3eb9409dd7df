"""Registration of the plugins with Mitsuba's active variant."""

from __future__ import annotations

from render.engine import Engine
from render.plugins import lens_camera, lunar_surface, star_field, star_tracer

_registered: dict[str, tuple[type, type, type]] = {}


def register_plugins() -> tuple[type, type, type]:
    """Make ``star_field``, ``lens_camera``, ``star_tracer`` (returned) and ``lunar_surface`` known to ``load_dict``.

    Classes belong to a variant: call this after every change of variant (`render.engine.Engine.start`). Calling
    it again does nothing.
    """
    engine = Engine.active()
    mi, variant = engine.mitsuba, engine.variant
    if variant not in _registered:
        emitter, sensor = star_field.define(mi), lens_camera.define(mi)
        integrator = star_tracer.define(mi, emitter, sensor)
        mi.register_emitter("star_field", emitter)
        mi.register_sensor("lens_camera", sensor)
        mi.register_integrator("star_tracer", integrator)
        mi.register_bsdf("lunar_surface", lunar_surface.define(mi))
        _registered[variant] = (emitter, sensor, integrator)
    return _registered[variant]
