"""Pulls, (estimate - truth) / sigma, of photon transfer, and their test."""

import numpy as np


def transfer_pulls(transfer, gain_dn_per_e, read_noise_e):
    """Pulls of gain and read noise."""
    return (
        (transfer.gain_dn_per_e - gain_dn_per_e) / transfer.gain_error_dn_per_e,
        (transfer.read_noise_e - read_noise_e) / transfer.read_noise_error_e,
    )


def assert_unit_pulls(pulls):
    """Mean 0 and RMS 1 of n pulls (n, ...), within four standard errors."""
    np.testing.assert_allclose(np.mean(pulls, axis=0), 0.0, atol=4.0 / np.sqrt(len(pulls)))
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(pulls), axis=0)), 1.0, atol=4.0 / np.sqrt(2 * len(pulls)))
