"""Stars through the lens onto pixels, one road: star, pupil sampling, trace, image by rays or by waves, sum and truth.

==========  ============================================================================================================
`tracer`    the road: star field and camera in, noiseless image and truth out
`motion/`   where stars are seen during an exposure
`pupil/`    which points of the launch disk stand for a beam: outlines, points inside, orders, groups of stars
`rays/`     the kernel that traces, and images by rays
`waves/`    images by diffraction: plane waves, their sums over windows, grids of images over the field
`truth`     stamps added to the image, sums made truth
`psf`       effective PSFs from the renderer, from rays and from wavefronts
`gradient`  the image as a function with derivatives, by rays and by waves
==========  ============================================================================================================
"""
