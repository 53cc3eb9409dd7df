"""The lens and light: prescriptions, perturbations, glass, rays, waves, paraxial optics, spectra, bands, drawings.

A lens is data: `load_lens` reads it, `tilt` and its like return changed copies. Rays are data: `star_rays` launches
them, `trace` carries them to the image plane. What they mean is computed by plain functions. One source of the trace
runs on NumPy and on Dr.Jit arrays (`trace_program`). No Mitsuba and no randomness here.

    from optics import draw_lens, load_lens, paraxial, spot_moments, tilt
    lens = tilt(load_lens("star_tracker_26mm"), "L6", x_deg=0.05)
    spots = spot_moments(lens, [0.0, 5.0, 10.0], [0.0, 0.0, 0.0], [500.0, 600.0, 700.0])
    draw_lens(lens).savefig("lens.png")

Public names (read from ``__init__.pyi``, loaded on first use) and the modules behind them:

==================================  ====================================================================================
optics.lens_file                    `load_lens`, `list_lenses`; `read_lens_file`, `LensFile`: Zemax, CODE V and TOML,
                                    with the report on every line
optics.lens.system                  `LensSystem`, `Surface`
optics.lens.shapes                  `Shape` and its kinds `Plane`, `Sphere`, `Conic`, `EvenAsphere`
optics.lens.perturb                 `tilt`, `decentre`, `despace`, `refocus`, `tilt_image`, `change_temperature`,
                                    `change_index`, `change_shape` (radius, conic, ...); what moves: an element,
                                    surfaces, `ALL_SURFACES`, `EVERYTHING`
optics.lens.heated_lens             `heated_lens`: gradients of temperature, `ThermalState`, `Housing`, `Mount`
optics.glass.catalogue              `get_glass`, `list_glasses`, `Glass`
optics.glass.coating                `Stack` of `Film`, `QuarterWave`, `TabulatedCoating`: R, T of s and p light
optics.glass.absolute_index         `Environment`, `CATALOGUE_AIR`, `VACUUM`
optics.rays.paraxial                `paraxial`, `axial_colour_mm`
optics.rays.chief_ray               `chief_ray_points`
optics.rays.distortion              `distortion_map`, `plate_scale_mm`
optics.rays.spots                   `spot_moments`, `trace_spots`
optics.rays.lateral_colour          `lateral_colour`
optics.rays.vignetting              `vignetting`, `collecting_area_mm2`
optics.rays.best_focus              `best_focus_shift_mm`, `white_focus`: spots through focus
optics.rays.entrance_pupil          `entrance_pupil`, `star_rays`
optics.rays.pupil_sampling          `gauss_disk`, `sobol_disk`
optics.rays.trace                   `Rays`, `trace`, `trace_program`
optics.rays.thermal_sensitivity     `thermal_sensitivity`, `athermal_spacer`
optics.rays.program                 `compile_lens`
optics.rays.reverse                 `reverse`
optics.rays.ghosts                  `find_ghosts`, `with_cover_glass`
optics.light.spectrum               `Blackbody`, `TabulatedSed`
optics.light.band                   `TopHat`, `TabulatedBand`, `band_nodes`
optics.light.magnitudes             `photon_rate`, `synthetic_magnitude`
optics.light.transmission           `lens_transmission`
optics.response                     `Response`
optics.waves                        `trace_pupil`, `wavefront`, `zernikes`, `zernike_map`, `strehl`,
                                    `strehl_through_focus`, `encircled_energy`, `transfer_function`, `with_wavefront`
optics.figures                      `draw_lens`, `draw_spots`, `draw_distortion`
optics.frame_html                   `frame_page`, `save_frame_page`, `Marks`: any frame as an HTML page to zoom into
optics.frames                       `field_direction`
optics.attitude                     `attitude_from_angles`, `angles_from_attitude`, `attitude_error_arcsec`
optics.errors                       `StarbenchError`
==================================  ====================================================================================
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
