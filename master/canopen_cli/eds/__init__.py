"""Device descriptions: `canopen eds`."""
