"""Stars through the lens onto pixels: directions, pupil sampling, trace, image by rays or by waves, sum and truth.

==========  ============================================================================================================
`tracer`    the pipeline: star field and camera in, noiseless image and truth out
`motion/`   directions of stars during an exposure; rolling shutter
`pupil/`    points of the launch disk for each beam: ray aiming, outlines, quadrature orders, Sobol points, transmission
`rays/`     the kernel that traces, and images by rays
`waves/`    images by diffraction: plane waves, their sums over windows, grids over the field, spikes of bright stars
`truth`     stamps added to the image, sums converted to the truth
`psf`       effective PSFs from the renderer, from rays and from wavefronts
`gradient`  the image as a function with derivatives, by rays and by waves
==========  ============================================================================================================
"""
