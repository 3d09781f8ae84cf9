"""Drives, chains of them and their cycles, on top of a `Master`."""
