"""The virtual laboratory: one small record per device, shared by all experiments."""
