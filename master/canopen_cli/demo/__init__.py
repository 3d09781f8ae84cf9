"""`canopen demo`."""
