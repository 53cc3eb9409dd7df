"""High spatial frequency error (ACC18 eq. 3-12): small steps of a hexapod, measured and predicted by cause.

A 5 x 5 point target is stepped over the pixels by 0.2 px at a time; thirty frames at every position are rendered, read
out, detected and centroided, and reduced as in the document. Response and offset patterns and bad pixels are switched
off one by one on the same random streams; the S-curve is the error of an image without noise.
"""
