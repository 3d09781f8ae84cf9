"""Simulated devices: `canopen sim`, and the drives behind `--eds`."""
