"""Calibration in orbit with frames linked by a gyro (method ACC of ACF17), compared with methods without a gyro.

Star positions with noise and gyro rates are simulated as in Table 1 of ACF17 and calibrated by the document's method
(ACC), with a gyro of stated noise, by interstar angles (IAC, as published and fully weighted) and with free attitudes,
a hundred times each; its Fig. 3 to 5 and Table 2 are compared with the truth and the Cramer-Rao bound. In addition: the
pixel size and number of stars implied by its numbers, and the number of stars per frame above which the gyro gives no
gain. The experiment ``skycal`` makes the same calibrations from rendered frames.
"""
