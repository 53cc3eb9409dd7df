"""Alignment of a sun sensor with its cube mirror (CUBE09) on a rendered bench: error of R_sp against its budget.

A collimated sun shines through an aperture onto a polished face of a cube mirror on a two-axis turntable; the table is
trimmed until the reflected spot is concentric with the aperture, first one face, then another, as the document does.
The sun sensor on the same table is calibrated by turning the table over its field. A hundred misaligned benches show
which term of the published budget (eq. 13 and 14) does what to which axis, and what would bring the error below 1
arcsec.
"""
