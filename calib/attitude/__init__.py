"""Attitude and identity: Wahba's problem, identification, association, gyro integration, ACF17's link."""
