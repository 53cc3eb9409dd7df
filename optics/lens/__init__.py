"""The lens as data: surface shapes, the prescription and its file, perturbed copies."""
