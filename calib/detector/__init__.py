"""Detectors from their frames: photon transfer, mean frames, fixed pattern, defective pixels."""
