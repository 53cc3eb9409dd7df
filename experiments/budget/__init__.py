"""Error budget of a star camera, term by term: predicted without frames, measured on frames, published (ACC18).

From one instrument (lens, detector, light, centroider, stars) every term is predicted by noise analysis, PSF sampling
and ray trace, and measured by running the virtual laboratory; both add up by eq. 31-32. Then: the predicted budget
against any parameter (--sweep defocus_mm=-0.2:0.2:9), sensitivities, temperature, and the attitude from N stars.
"""
