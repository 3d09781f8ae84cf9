"""Python on an open bus: `canopen run` and `canopen shell`."""
