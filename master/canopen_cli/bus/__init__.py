"""A bus and who is on it: `canopen bus`, `doctor`, `scan`, `nmt`."""
