"""How accurate a star camera is, term by term: predicted without frames, measured on rendered ones, published (ACC18).

From one instrument (lens, detector, light, centroider, stars) every term is predicted by noise analysis, PSF sampling
and ray trace, and measured by running the virtual laboratory; both add up by eq. 31-32. Then: sensitivities, lenses as
built, temperature, and the attitude from N stars.
"""
