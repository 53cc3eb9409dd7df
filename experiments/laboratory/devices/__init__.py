"""Devices of the laboratory: collimator and targets, hexapod, turntable, filters, the instrument under test."""
