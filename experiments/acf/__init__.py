"""Calibration of a star sensor with attitude-correlated frames (ACF17): Fig. 3 to 5 and Table 2, on star coordinates.

Star positions with noise and gyro rates are simulated as in Table 1 and calibrated by the document's method (ACC), with
a gyro of stated noise, by interstar angles (IAC, as published and fully weighted) and with free attitudes, a hundred
times each; everything stands beside the truth and the Cramer-Rao bound. Then what the document lacks: the pixel and the
number of stars that its numbers imply, from how many stars per frame on the gyro gains nothing, and the same
calibration on rendered frames (all of which is the experiment ``skycal``).
"""
