"""Several sensors side by side, predicted under the same sky."""
