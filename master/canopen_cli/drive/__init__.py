"""One drive: `canopen drive`, and `canopen home`, which homes several."""
